"""Foundations: errors, values, files, trust, plugins, agents, commands, compiled code, processes.

All rooms may import this room, and it imports no other room.
"""

from tb2rl.core.agent import ANY_POLICY, Agent, find_agent
from tb2rl.core.errors import InputError, UnknownArgumentError, one_line, unknown
from tb2rl.core.files import check_output, find_file, read_text, read_yaml, top_folder, write_json, write_text
from tb2rl.core.plugins import (
    agent_names,
    find_plugin,
    import_object,
    make_part,
    reference_to,
    robot_names,
    simulator_names,
    task_names,
)
from tb2rl.core.signals import exit_by_signal, handle_termination_signals, ignore_termination_signals
from tb2rl.core.trust import block_imports, check_file_allowed, untrusted_source

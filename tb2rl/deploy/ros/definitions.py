"""Messages and services that programs of the ROS tutorial import, and Debian does not have, made by genpy.

What two programs must agree on is the order and the types of the fields: a checksum of these (of `gazebo_msgs`, of
`controller_manager_msgs`, of the tutorial's `openai_ros`) is compared where they meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import dedent

from tb2rl.deploy.ros.debian import find_rospy

VECTOR = {"geometry_msgs/msg/Vector3.msg": "float64 x\nfloat64 y\nfloat64 z\n"}
MISSING = {
    "gazebo_msgs/msg/ODEPhysics.msg": """
        bool auto_disable_bodies
        uint32 sor_pgs_precon_iters
        uint32 sor_pgs_iters
        float64 sor_pgs_w
        float64 sor_pgs_rms_error_tol
        float64 contact_surface_layer
        float64 contact_max_correcting_vel
        float64 cfm
        float64 erp
        uint32 max_contacts
        """,
    "gazebo_msgs/srv/SetPhysicsProperties.srv": """
        float64 time_step
        float64 max_update_rate
        geometry_msgs/Vector3 gravity
        gazebo_msgs/ODEPhysics ode_config
        ---
        bool success
        string status_message
        """,
    "controller_manager_msgs/srv/SwitchController.srv": """
        string[] start_controllers
        string[] stop_controllers
        int32 strictness
        int32 BEST_EFFORT=1
        int32 STRICT=2
        bool start_asap
        float64 timeout
        ---
        bool ok
        """,
    "openai_ros/msg/RLExperimentInfo.msg": """
        int32 episode_number
        float32 episode_reward
        """,
}
# Python joins a written package with an installed one of the same name, such as the tutorial's openai_ros.
JOINED = '__path__ = __import__("pkgutil").extend_path(__path__, __name__)\n'


def write_packages(folder: Path, definitions: Mapping[str, str] = MISSING) -> None:
    """Write packages of Python with the messages and services of ROS 1 that texts define.

    Args:
        folder: What is to be in PYTHONPATH; it is made.
        definitions: By the path of their file, PACKAGE/msg/NAME.msg or PACKAGE/srv/NAME.srv.

    Raises:
        InputError: If ROS 1 is not installed.
    """
    find_rospy()
    from genpy.generate_initpy import write_modules
    from genpy.generator import MsgGenerator, SrvGenerator

    with TemporaryDirectory() as scratch:
        files = [_write(Path(scratch, name), text) for name, text in {**VECTOR, **definitions}.items()]
        known = {file.parts[-3]: [str(file.parents[1] / "msg")] for file in files}
        for name in definitions:
            package, part, _ = name.split("/")
            generator = MsgGenerator() if part == "msg" else SrvGenerator()
            out = folder / package / part
            failed = generator.generate_messages(package, [str(Path(scratch, name))], str(out), known)
            assert not failed, "genpy has said why"
            write_modules(str(out))
            init = folder / package / "__init__.py"
            if not init.exists():
                init.write_text(JOINED, encoding="utf-8")


def _write(file: Path, text: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(dedent(text), encoding="utf-8")
    return file

"""Better settings: trials of settings that Optuna proposes, the best of them judged, and a page that says so.

`study.py` is the place to begin. Imported from here: learning and what lies below it. Nothing but the command `tune`
imports this room, for it needs Optuna, the extra `tune`.
"""

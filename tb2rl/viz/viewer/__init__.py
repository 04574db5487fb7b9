"""The live viewer: a 3D page in the browser for policies, worlds, goals and trainings, on `viser`."""

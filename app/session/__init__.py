"""One window's worth of work, without the window.

`workspace` is the state and its edits; three controllers change it: `scene_controller` loads, `training_controller`
trains, `project_files` opens, saves and closes. `session` owns all four.
"""

"""One window's worth of work, without the window.

`workspace` is the state and its edits; controllers act on it, for example `scene_controller`, which loads,
`training_controller`, which trains, and `project_files`, which opens, saves and closes. `session` is the workspace
together with its controllers.
"""

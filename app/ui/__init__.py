"""The window: it draws a session and passes on what the user does. No state here should be part of undo or of a file.

`window` runs the frames; `menus`, `commands` and `toolbar` are the menu bar, shortcuts and tools; `panels` is the right
side, `view` the object in the middle, `film` the timeline below it, `dialogs` what opens above them; `theme` and
`widgets` are used by all.
"""

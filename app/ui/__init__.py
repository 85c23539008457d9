"""The window: it draws a session and passes on what the user does, and has no state that undo or a file should cover.

`window` runs the frames; `menus` and `commands` are the menu bar, toolbar and shortcuts; `panels` is the right side,
`view` the object in the middle, `dialogs` what opens above both; `theme` and `widgets` are used by all.
"""

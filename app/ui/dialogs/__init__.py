"""What opens above the window: file dialogs, and the export window with the exporter behind it."""

"""Dialogs above the window: questions, files, even slicing, and exports with the exporter behind them."""

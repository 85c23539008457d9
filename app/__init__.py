"""The desktop app, in four rooms, each importing only those before it: model, jobs, session, ui."""

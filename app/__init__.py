"""The desktop app in four packages, each of which imports only those before it: model, jobs, session, ui."""

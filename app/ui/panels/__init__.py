"""The inspector at the right: object, cuts and pieces (`inspector`), families and training (`interior`)."""

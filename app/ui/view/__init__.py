"""The viewport: `viewport` handles the pointer, `painter` draws the object, the others what lies over it."""

"""The viewport: `viewport` handles the pointer, `painter` draws the object, and the others draw what lies over it."""

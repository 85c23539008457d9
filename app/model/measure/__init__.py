"""Three faces across each other, and what is measured on them."""

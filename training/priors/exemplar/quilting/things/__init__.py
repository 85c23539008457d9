"""Things of photographs that are laid whole, as solids: grains that fill a face, seeds that lie apart, and its core."""

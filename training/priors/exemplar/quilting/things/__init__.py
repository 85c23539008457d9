"""Things of photographs that are laid whole, in every cut: grains that fill a face, and seeds that lie apart in it."""

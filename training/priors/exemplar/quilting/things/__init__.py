"""Things of photographs that are laid whole, in every cut: grains that fill a face, seeds that lie apart, its core."""

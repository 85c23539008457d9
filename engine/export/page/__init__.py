"""A web page that shows a solid without a network: its skin's atoms, its inside as a volume, and what draws them."""

"""The mathematics that algorithms of a family share, as pure functions over the run axis."""

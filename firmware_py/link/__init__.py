"""Description of a link in `link.toml`: geometry, markers, gravity, servo."""

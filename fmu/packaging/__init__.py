"""Parts of an FMU file beside model description and equations: binaries, sources, documents."""

"""Parts of an FMU file other than model description and equations: binaries, sources, documents."""

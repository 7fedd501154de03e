"""What every room uses: errors, units, signals, documents, bounded files, console, motions."""

"""How often the gap workflow names a hidden effect rightly, measured on the virtual laboratory."""

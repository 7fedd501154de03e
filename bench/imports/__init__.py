"""Imports that are made right and wrong, and what the importer says of them."""

"""Small pictures with free licences, named in ATTRIBUTION.md beside them."""

"""Fields, forms and panels of Qt."""

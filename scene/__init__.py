"""Photographs become posed views, a radiance field, and new views of the scene."""

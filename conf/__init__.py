"""Every setting, and what ties the rooms together."""

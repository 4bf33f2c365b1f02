"""The family `composer`: games assembled from typed mechanics, and a player for them."""

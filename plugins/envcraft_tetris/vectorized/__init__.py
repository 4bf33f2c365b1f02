"""A simulator that steps many variants in one process and matches their generated sources bit for bit."""

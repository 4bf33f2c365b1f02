"""Gymnasium spaces as data: read, write, validate, sample, encode and decode."""

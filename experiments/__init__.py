"""Wires laboratory and identification together; nothing imports it."""

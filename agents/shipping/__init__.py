"""Shipping weights: licences, provenance, model cards."""

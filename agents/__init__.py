"""Policies, their training and their evaluation."""

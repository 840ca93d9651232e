"""Warnings of scenes and poses that are valid but can hardly be meant."""

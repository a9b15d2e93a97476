"""What happens around training: saving, watching, stopping."""

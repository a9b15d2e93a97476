"""Views of a result: a self-contained HTML page, a contact sheet, TensorBoard events."""

"""Lightning modules: thin, one for each thing that is trained."""

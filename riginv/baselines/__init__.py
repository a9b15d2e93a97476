"""The prior methods that the paper cites, each as a `Method` (`riginv.methods.base`); docs/baselines.md lists them."""

"""From a clip to controls over time: rigid motion removed, missing vertices filled in, controls found, frames judged."""

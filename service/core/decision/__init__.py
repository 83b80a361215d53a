"""The decision: suspected, confirmed, ranked explanations, and the events that follow from them."""

"""gelgate, the gateway: from a press of the sensor to a verdict that the plant can subscribe to."""

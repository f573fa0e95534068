"""MQTT clients of the broker."""

"""USB: finding a sensor on a bus, UVC as values, payloads, streaming, locks; a real and a virtual bus look the same."""

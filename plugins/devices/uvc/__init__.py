"""USB: finding a sensor on a bus, UVC as values, payloads, streaming, locks; the same for a real and a virtual bus."""

"""Pedals, buttons, lights and relays: HID and GPIO drivers, and a virtual HID bus."""

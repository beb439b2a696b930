"""A robot that lifts the part when the station says so: MQTT alone, without gelgate.

    pip install paho-mqtt
    python lift_when_judged.py HOST PORT gelgate/site/line/station/gel/v1

It prints `lift <press id>` where a robot would lift, and `retreat` where the press is too deep. What is older than half
a second does not count: the station says it again five times a second while something touches. So the clocks of both
must agree within that, as with NTP; where they do not, nothing is lifted.
"""

import json
import queue
import sys
import time

import paho.mqtt.client as mqtt


def main(host, port, root):
    news, is_ready, lifted = queue.Queue(), False, None
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_connect = lambda *_: client.subscribe([(f"{root}/state", 1), (f"{root}/contact", 0)])
    client.on_message = lambda _client, _data, message: news.put(message)
    client.connect(host, int(port), keepalive=5)
    client.loop_start()
    while True:
        message = news.get()  # a robot that waits here stays where it is
        payload = json.loads(message.payload)
        if message.topic.endswith("/state"):
            is_ready = payload["state"] == "ready"
        elif not is_ready or abs(time.time_ns() - payload["time_ns"]) > 0.5e9:
            continue  # another part may lie there by now
        elif payload["state"] == "overload":
            print("retreat", flush=True)
        elif payload["state"] == "lift" and payload["press_id"] != lifted:
            lifted = payload["press_id"]
            print("lift", lifted, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

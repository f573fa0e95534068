"""Talks to the broker: connects, publishes a sensor's results and health, takes requests.

In: frames' results, payloads. Out: messages and requests.
Threads: paho's.
Other rooms use: `caller`, `client`, `client_id_guard`, `follower`, `home_assistant`, `link`,
    `links`, `outgoing`, `publishing`, `subscription`.
"""

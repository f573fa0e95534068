"""The bytes that leave a sensor: topics, JSON, binary payloads, requests and their results. Pure.

In: values. Out: bytes, and values again.
Threads: none.
Other rooms use: `binary`, `broker_address`, `codec`, `error_words`, `hand_messages`,
    `hand_topics`, `health_topics`, `messages`, `requests`, `results`, `sensor_topics`,
    `stamped_jpeg`, `topics`.
"""

"""The rig: a simulated urea dosing system with its controller, sensors, loggers and faults.

It shares nothing with what it tests: own physics, own parameters, own encoding. The rest of the project sees its
recordings, never its source.

    cycles, faults, vehicles  what is asked for
    plant, pump, valve        the physics;  ecu, sensors: what measures and controls it
    simulation                one run in memory, hidden state included
    can_logger, second_logger, recording: what of it reaches the files
    command                   `faultline rig`
"""

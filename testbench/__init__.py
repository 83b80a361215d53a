"""The rig: a simulated urea dosing system with its controller, sensors, loggers and faults.

It shares nothing with what it tests: own physics, own parameters, own encoding. The rest of the project sees its
recordings, never its source.

    request                   what is asked for, of cycles, faults, effects, vehicles
    plant, pump, valve        the physics;  ecu, sensors: what measures and controls it
    simulation                a run in memory, hidden state included
    traffic, sensor_box       what of it reaches the bus;  second_logger: what reaches the bench's other logger
    recording, play           the files, or live onto a bus;  recorded, picture: the files seen again
    command, options          `faultline rig`
"""

"""Plants of other authors: families of urea dosing systems that differ in structure from the rig and from each other.

What is right on the rig may be right there only. A family draws plants whose integrator, controller, motor, valve,
sensors, sampling, cycle and surroundings are its own; the rig's physics is not used. Unless an effect is hidden in
them they are *sound*: the four-state diagnosis model, with each plant's data sheet, describes them.

    circuit      the hydraulics and its integrators
    control      what turns the pump and opens the valve
    cycle        what is asked for over time
    sensed       what sensors and logger make of it
    plant        a plant of all these, and its run
    draw         the families
    recording    the files of a recording
"""

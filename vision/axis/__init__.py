"""The corridor's axis in one picture: level, heading, vanishing point; and the field of view of an unknown camera.

Imports `vision.lines` and `vision.cameras`. Begin reading at `vision.axis.vanishing_point`: `fit_axis` finds the axis
by a vote (`vision.axis.vote`), whose peaks (`vision.axis.peaks`) are candidates, and a least-squares fit.
`vision.axis.level` corrects roll and pitch by vertical lines beforehand, `vision.axis.acceptance` decides whether the
heading may be used. Independent of these, `vision.axis.field_of_view` estimates the focal length of an uncalibrated
camera from the right angles between corridor lines, transverse lines and door posts (`vision.axis.right_angles`).
"""

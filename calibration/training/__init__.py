"""The backbone made for touch: a ResNet-18 trunk trained on presses that never existed.

`recipe` names every setting; `presses` draws random parts, defects and sensors; `render` turns them into frames on
whatever device torch has; `losses` says what is learnt; `train` is the loop; `package` makes the shipped graphs.
torch is imported by these modules alone, and they are imported at use.
"""

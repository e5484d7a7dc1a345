"""Makes one scenario of another: a part of it, its variations, and the same drive in another frame
or on another clock.
"""

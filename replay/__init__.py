"""Drive it: world, loops, vehicle, controllers, traffic; and what is made of a drive."""

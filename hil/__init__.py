"""Software and hardware in the loop: emulated servo, wire, timing verdict, report."""

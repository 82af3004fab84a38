# What every shell of bin/aerie remote begins with. IEx's v/1 gives way to ours.
import IEx.Helpers, except: [v: 1]
import Aerie.Shell
Aerie.Shell.greet()

defmodule Aerie.Vehicle.Command.Refusal.Policy do
  @moduledoc "What the policy refuses, and who is in charge of a vehicle (`Aerie.Vehicle.Command.Refusal`)."

  @fence_needs "fence_upload needs the permission protection"
  @shape_needs "set_parameter needs the permission protection"
  @in_charge "%{holder} is in charge of the vehicle (since %{since} UTC)"
  @take_over "take_control takes over"
  @take_first "needs take_control first"
  @only_while "%{command} is allowed only while the vehicle is %{state}"
  @limited "and modes are limited (policy.modes)"

  @by "policy"
  @rules [
    {:unknown, @by, :denied, 403, "nobody may send this: it has no row among what may pass",
     "send what [the policy](policy.md#raw-mavlink) lists, or set `policy.unknown`",
     command_unlisted:
       "the gateway does not know the command %{id} (MAV_CMD), and policy.open does not open it",
     message_unlisted: "the gateway does not know the message %{id}, and policy.open does not open it"},
    {:number, @by, :denied, 403, "the firmware would read this number as another one",
     "give a number that the firmware has", number: "%{command}: %{wrong}"},
    {:role, @by, :denied, 403, "the source lacks the role or the permission that it needs",
     "give it the [role or permission](policy.md#roles)",
     permission: "%{command} needs the permission %{permission}%{held}",
     nobody_signed_in: ", and nobody is signed in",
     not_given: ", which no role includes; %{source} (%{role}) was not given it",
     not_in_role: "; %{source} is %{role}, which does not include it",
     cancel_needs: "cancelling %{command} needs the permission %{permission}, which %{source} does not have",
     shape_unknown: @shape_needs <> ": %{name} may shape the path of the vehicle, and it is not known how",
     shape_beyond:
       @shape_needs <>
         ": %{name} is %{meaning}, and %{value} is not known to keep the vehicle within its fence and its limits",
     fence_smaller:
       @fence_needs <> ": the new fence does not keep the vehicle everywhere where the one aboard does",
     fence_unread: @fence_needs <> ", because the fence aboard could not be read"},
    {:lease, @by, :denied, 403, "somebody else is in charge of the vehicle, or steers it",
     "take over with a reason, or ask for a hand-over ([who is in charge](policy.md#who-is-in-charge))",
     nobody_in_charge: "nobody is in charge",
     nobody_took_it:
       "nobody is in charge of the vehicle; %{command} " <> @take_first <> " (policy.lease.required)",
     unheard: "nobody can be in charge of a vehicle that was not heard yet",
     in_charge: @in_charge,
     in_charge_of_all: @in_charge <> "; " <> @take_over,
     take_over_admin: @in_charge <> "; only an admin may take over (policy.lease.take_over)",
     take_over_reason: @in_charge <> "; taking over needs a reason",
     steered:
       "%{command}: %{name} steers it, until it has sent nothing for a while; anyone who may can disarm it",
     steered_many: "too many vehicles are steered at once"},
    {:window, @by, :denied, 403, "the time of day is outside of the windows of the policy",
     "wait, or change `policy.windows`", window: "%{command} is allowed %{windows} only; it is %{now}"},
    {:condition, @by, :denied, 403, "the vehicle's state does not fit a condition of the policy",
     "the reason names it",
     condition_unknown: @only_while <> "; whether it is, is not known",
     condition: @only_while <> "; it is %{is}"},
    {:battery, @by, :denied, 403, "the battery is too low for a takeoff, or not known",
     "charge or change it, or lower `policy.takeoff_battery`",
     battery_unknown: "%{command} needs %{floor} of the battery's charge; how much is left is not known",
     battery_low: "%{command} needs %{floor} of the battery's charge; %{left} is left"},
    {:mode, @by, :denied, 403, "this mode is not allowed, or not known",
     "choose another one, or change `policy.modes`",
     mode_denied: "the mode %{mode} is not allowed (modes.denied)",
     mode_unknown: "what the mode %{mode} does is not known, " <> @limited,
     mode_standard: "which of its modes the standard mode %{mode} is for this vehicle is not known",
     mode_switched: "%{command}: %{unknown}, " <> @limited,
     mode_change: "from %{from} the mode may change to %{allowed}, not to %{mode}",
     mode_change_unknown:
       "whether the mode may change to %{mode} depends on the vehicle's mode, which is not known"},
    {:altitude, @by, :denied, 403, "it leads above or below the limits of height",
     "change the height, or the limits",
     height: "%{place} is %{height} %{above}; %{limit} is allowed",
     height_unknown: "%{place} must be %{limit} %{above}; how high it is, is not known, because %{unknown}",
     heights_unknown: "a limit of altitude applies to %{command}, and %{unknown}"},
    {:geofence, @by, :denied, 403, "it leads outside of the fence of the policy, or past it",
     "change the place, or the fence",
     place_unknown: "a fence applies to %{command}, and %{unknown}",
     place_inside: "%{place} is in the exclusion zone \"%{zone}\", %{metres} inside its border%{band}",
     place_outside: "%{place} is %{metres} outside %{zone}",
     place_height: "%{place} is outside the heights of %{zone}%{band}",
     room:
       "%{place} needs %{metres} around it, because %{why}; " <>
         "the border of the %{kind} zone \"%{zone}\" is %{away} away",
     way_long: "%{place} is %{length} long; ways of more than %{most} are not judged",
     way_leaves: "%{place} (%{length}) leaves %{zones} after %{after}",
     way_enters: "%{place} (%{length}) enters the exclusion zone \"%{zone}\" after %{after}",
     way_to_mission_unknown: "a fence or a limit of height applies to the way to its mission, and %{unknown}",
     ways_many: "the mission has more ways than can be judged; use fewer jumps",
     breach: "%{how}; force sends it nevertheless"},
    {:disarmed, @by, :denied, 403, "a disarmed vehicle would store it, and move when it is armed",
     "arm the vehicle first",
     disarmed: "arm the vehicle first: %{command} now would move it as soon as it is armed"},
    {:rate, @by, :denied, 429, "this source sends more than the rates allow",
     "send less often, or change `policy.rates`",
     rate: "%{source} may command %{command} of %{vehicle} %{rate}; the next one is allowed in %{seconds} s",
     rate_uncounted: "%{source} commanded too many vehicles just now to be counted; try again in a moment",
     plans_many: "too many plans are written just now to be judged"}
  ]

  @doc "Its rules."
  @spec rules() :: [tuple()]
  def rules, do: @rules

  @doc "A text for the console's pages, which have a form in place of `take_control`."
  @spec on_pages(String.t()) :: String.t()
  def on_pages(text) do
    text
    |> String.replace(@take_over, "take over under “in charge”")
    |> String.replace(@take_first, "needs somebody in charge: take charge first")
  end
end

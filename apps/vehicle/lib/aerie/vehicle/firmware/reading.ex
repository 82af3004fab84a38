defmodule Aerie.Vehicle.Firmware.Reading do
  @moduledoc """
  How a firmware reads what is sent to it, where firmwares differ: by this the policy judges messages. The defaults are
  those of an unknown one, for which each way counts that any firmware has.
  """

  @every_way [:whole, :driven, :by_axis, :height]

  defstruct keeps_nan?: false,
            long_height: :home,
            ignores_frame?: false,
            zero_place: :either,
            guided_items: :either,
            plan_whole?: false,
            mission_start_arms?: false,
            mode_in_bytes?: false,
            safety_flag: :switch,
            setpoints: %{any: @every_way},
            setpoint_timeout: {"GUID_TIMEOUT", 3.0},
            stays_at_setpoint?: true,
            kill_gesture?: true,
            steered_by: :either

  @typedoc """
    * `:keeps_nan?` - whether it leaves as it is what a command has as NaN; else it makes any number of it
    * `:long_height` - what the height in COMMAND_LONG is above, which has no frame: `:home` or `:msl`
    * `:ignores_frame?` - whether it takes heights as above mean sea level whatever the frame of a command says
    * `:zero_place` - whether latitude and longitude 0 of an item or a take-off are where it is (`:here`) or a place
      (`:there`)
    * `:guided_items` - whether an item with `current` 2 or 3 is obeyed at once (`:obeyed`) or stored (`:stored`)
    * `:plan_whole?` - whether it flies the old mission until the new one is complete
    * `:mission_start_arms?` - whether MISSION_START arms it
    * `:mode_in_bytes?` - whether DO_SET_MODE has main and sub mode as a byte each, in place of one number
    * `:safety_flag` - what the flag "armed" in a mode's base means: the safety switch (`:switch`), or arming (`:arms`)
    * `:setpoints` - how it reads the mask of a set-point, by kind of vehicle (`:any` for the others):
      `:whole` - a position, velocity or acceleration only if none of its axes is masked; `:driven` - a speed in a
      direction, which a yaw replaces; `:by_axis` - each axis apart; `:height` - the height alone; `:depth` - the height
      if that is all
    * `:setpoint_timeout` - the parameter for how long it obeys set-points that stop, and its default in seconds
    * `:stays_at_setpoint?` - whether it stays at the place of a set-point, with the room that this takes
    * `:kill_gesture?` - whether sticks in their corners may stop its motors
    * `:steered_by` - whether it is armed and steered by `:commands`, or by `:channels` in the place of its pilot's
  """
  @type t :: %__MODULE__{}
end

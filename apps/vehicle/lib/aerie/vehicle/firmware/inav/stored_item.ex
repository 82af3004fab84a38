defmodule Aerie.Vehicle.Firmware.Inav.StoredItem do
  @moduledoc """
  What iNav keeps of the items of a mission, as `Msp.Mission` makes waypoints of them: heights and speeds in cm, times, directions and
  heights of the ground in whole units, no radii.
  """

  alias Protocols.Mission.StoredItem
  alias MavCodec.Enums.{MavCmd, MavFrame}

  @none MavFrame.value(:MAV_FRAME_MISSION)
  # Half of the last digit, and what a 32-bit float costs.
  @half_cm 0.0051
  @half 0.501
  @bare %{
    frame: [@none],
    param2: :any,
    param3: :any,
    param4: :any,
    x: :any,
    y: :any,
    z: :any,
    autocontinue: :any
  }

  @command Map.new(
             ~w(NAV_WAYPOINT NAV_LOITER_TIME NAV_RETURN_TO_LAUNCH NAV_LAND DO_JUMP DO_SET_ROI DO_SET_ROI_LOCATION DO_SET_ROI_NONE
                CONDITION_YAW DO_CHANGE_SPEED USER_1)a,
             &{MavCmd.value(:"MAV_CMD_#{&1}"), &1}
           )
  @loiter MavCmd.value(:MAV_CMD_NAV_LOITER_TIME)
  @roi MavCmd.value(:MAV_CMD_DO_SET_ROI_LOCATION)

  @doc "See `c:Protocols.Mission.Firmware.kept/3`."
  @spec kept(map(), 0..2) :: StoredItem.t()
  def kept(item, 0), do: fields(Map.get(@command, item.command), item)
  def kept(_item, _other_kind), do: %{}

  defp fields(:NAV_WAYPOINT, item) do
    if (param(item, 1) || 0) < @half,
      do: Map.put(place(item), :param1, :any),
      else: Map.put(fields(:NAV_LOITER_TIME, item), :command, [@loiter])
  end

  defp fields(:NAV_LOITER_TIME, item), do: Map.put(place(item), :param1, near(param(item, 1), @half))

  defp fields(:NAV_LAND, item),
    do: Map.merge(place(item), %{param1: :any, param3: near(param(item, 3), @half)})

  defp fields(name, item) when name in [:DO_SET_ROI, :DO_SET_ROI_LOCATION],
    do: Map.merge(place(item), %{command: [@roi], param1: :any})

  defp fields(:NAV_RETURN_TO_LAUNCH, item), do: Map.merge(@bare, numbers(item, [1], @half))
  defp fields(:DO_SET_ROI_NONE, _item), do: Map.put(@bare, :param1, :any)

  defp fields(:CONDITION_YAW, item),
    do: Map.put(@bare, :param1, {:angle, (param(item, 1) || 0) * 1.0, @half})

  defp fields(:DO_JUMP, item), do: Map.merge(@bare, numbers(item, [1, 2], @half))

  # The kind of speed is that above the ground.
  defp fields(:DO_CHANGE_SPEED, item),
    do: Map.merge(@bare, %{param1: :any, param2: near(param(item, 2), @half_cm)})

  defp fields(:USER_1, item), do: Map.merge(@bare, numbers(item, [1, 2, 3, 4], @half))
  defp fields(nil, _item), do: %{}

  defp numbers(item, which, tolerance),
    do: Map.new(which, &{:"param#{&1}", near(param(item, &1), tolerance)})

  defp param(item, number), do: elem(item.params, number - 1)

  defp place(item),
    do: %{param2: :any, param3: :any, param4: :any, autocontinue: :any, z: near(item.z, @half_cm)}

  defp near(value, tolerance), do: {:near, [(value || 0) * 1.0], tolerance}
end

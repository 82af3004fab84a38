defmodule Aerie.Vehicle.Firmware.Px4.Plans do
  @moduledoc """
  What PX4 reports about a plan after acknowledging it. Its feasibility check runs after MISSION_ACK, and only an EVENT reports that it
  rejected the mission; MISSION_CURRENT then shows "no mission" with the id of the new one. A fence is checked against
  home within a second.
  """

  alias MavCodec.Enums.{MavMissionType, MissionState}
  alias MavCodec.Messages, as: M

  @mission MavMissionType.value(:MAV_MISSION_TYPE_MISSION)
  @fence MavMissionType.value(:MAV_MISSION_TYPE_FENCE)
  # MISSION_CURRENT comes at once after a change, otherwise every one to three seconds.
  @watch_us %{0 => 4_000_000, 1 => 1_500_000, 2 => 0}
  @no_mission MissionState.value(:MISSION_STATE_NO_MISSION)
  # Errors and worse (log level 0 to 3, the lower half of the byte); first_wp_far and the like are warnings.
  @error 3

  @rejected %{
    17_390_995 => "a landing approach needs a waypoint before it",
    18_702_382 => "it begins with a landing",
    19_546_926 => "a landing is needed, or the take-off has to go",
    19_608_877 => "an item lies outside the fence",
    19_619_824 => "in the air a landing is required",
    19_975_651 => "the approach is below the landing",
    20_155_474 => "an item is relative to home, and home is not known",
    20_160_430 => "an item could not be read",
    20_230_345 => "the fence needs a home",
    21_551_397 => "the glide slope is too steep",
    22_271_714 => "it needs a take-off",
    22_572_417 => "the fence needs a home",
    22_901_736 => "it begins with a landing",
    24_637_881 => "the landing is after an RTL",
    25_102_077 => "the vehicle has no position",
    25_237_137 => "it needs a landing",
    25_552_931 => "it has a command that PX4 does not support",
    25_671_925 => "the landing lies inside the circle before it",
    28_298_937 => "it has items for VTOLs",
    28_985_965 => "the take-off is too low",
    29_001_630 => "it needs a take-off or a landing",
    29_545_429 => "it has several landings",
    30_155_728 => "two gates are too close to each other",
    30_733_418 => "the landing is not valid",
    33_286_782 => "a take-off is needed, or the landing has to go",
    33_440_290 => "the take-off is not its first item"
  }
  @fence_rejected %{
    26_209_321 => "the fence does not contain the vehicle's position",
    27_750_677 => "the fence does not contain home"
  }

  @doc "For how long after its acknowledgement PX4 may still reject a plan."
  @spec watch_us(0..2) :: non_neg_integer()
  def watch_us(mission_type), do: Map.fetch!(@watch_us, mission_type)

  @doc "`c:Protocols.Mission.Firmware.plan_verdict/3`."
  @spec verdict(struct(), 0..2, non_neg_integer() | nil) ::
          :ignore | :valid | {:invalid | :doubtful, String.t()}
  def verdict(%M.Event{id: id, log_levels: levels}, @mission, _opaque)
      when is_map_key(@rejected, id) and rem(levels, 16) <= @error,
      do: {:invalid, "PX4 rejected it after the upload: " <> Map.fetch!(@rejected, id)}

  def verdict(%M.Event{id: id}, @fence, _opaque) when is_map_key(@fence_rejected, id),
    do: {:invalid, "PX4 rejected it after the upload: " <> Map.fetch!(@fence_rejected, id)}

  def verdict(%M.Statustext{text: "Mission rejected: " <> why}, @mission, _opaque),
    do: {:invalid, "PX4 rejected it after the upload: " <> String.trim(why)}

  def verdict(%M.MissionCurrent{mission_id: id} = m, @mission, id) when is_integer(id) and id != 0 do
    cond do
      m.mission_state == @no_mission -> {:doubtful, "PX4 shows that it has no mission that it can fly"}
      m.mission_state > @no_mission -> :valid
      true -> :ignore
    end
  end

  def verdict(_message, _mission_type, _opaque), do: :ignore
end

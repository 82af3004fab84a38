defmodule Aerie.Vehicle.State.Flight do
  @moduledoc """
  Whether the vehicle is in the air.

  1. A rover, boat or submarine never is.
  2. EXTENDED_SYS_STATE says it, if it came within the last five seconds and knows.
  3. ArduPilot's heartbeat says it: ACTIVE is flying, STANDBY is not (and in a failsafe neither is said).
  4. Else by height: above 1.5 m it flies; below 0.5 m with less than 0.3 m/s it does not; in between it is what it was.
     A vehicle that is not armed does not fly. Without a height it is not known.
  """

  alias Aerie.Vehicle.{Kind, State}

  @fresh_us 5_000_000
  @up_m 1.5
  @down_m 0.5
  @still_m_s 0.3
  @on_ground 1
  @airborne [2, 3, 4]

  @doc "Whether it flies as of now, `:same` when that is what the state says already. Nil as long as it is not known."
  @spec in_air(State.t(), integer()) :: boolean() | nil | :same
  def in_air(state, at) do
    mode = State.data(state, :mode)

    case judge(state, mode, at) do
      same when same == mode.in_air -> :same
      in_air -> in_air
    end
  end

  defp judge(state, mode, at) do
    cond do
      mode.armed == nil -> nil
      not Kind.flies?(state.kind) -> false
      true -> told(state.landed, at) |> fall_back(state, mode)
    end
  end

  defp told({@on_ground, when_told}, at) when at - when_told <= @fresh_us, do: false
  defp told({landed, when_told}, at) when landed in @airborne and at - when_told <= @fresh_us, do: true
  defp told(_undefined_old_or_never, _at), do: nil

  defp fall_back(told, _state, _mode) when is_boolean(told), do: told
  defp fall_back(nil, _state, %{armed: false}), do: false
  defp fall_back(nil, %{autopilot: :ardupilot}, %{system_status: "ACTIVE"}), do: true
  defp fall_back(nil, %{autopilot: :ardupilot}, %{system_status: "STANDBY"}), do: false

  defp fall_back(nil, state, mode) do
    height = State.data(state, :position).alt_rel
    sinking = State.data(state, :velocity).vd

    cond do
      height == nil -> mode.in_air
      height > @up_m -> true
      height < @down_m and abs(sinking || 0.0) < @still_m_s -> false
      true -> mode.in_air || false
    end
  end
end

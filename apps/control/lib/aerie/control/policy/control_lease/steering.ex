defmodule Aerie.Control.Policy.ControlLease.Steering do
  @arming_us 18_000_000
  @begun_us 10_000_000
  @sticks_us 1_000_000

  @moduledoc """
  The one source that steers a vehicle with MSP. Its session sends the channels of one source, which it knows by
  system and component only, and those are the gateway's own for all of its keys and users, and the same for most
  ground stations. So the principal is asked before that (`claim/5`): a key, a user, or a program by its connection.

  It steers for #{div(@sticks_us, 1_000_000)} s after sticks, #{div(@begun_us, 1_000_000)} s after it chose a mode, and
  #{div(@arming_us, 1_000_000)} s after it asked to arm, as the session waits for it (`Msp.Receiver`). Anyone with the
  permission may disarm, which ends it.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy.{Intent, ControlLease, Roles}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware

  @until %{
    "arm" => @arming_us,
    "set_mode" => @begun_us,
    "rtl" => @begun_us,
    "hold" => @begun_us,
    "manual_control" => @sticks_us,
    "rc_override" => @sticks_us
  }
  @ends ~w(disarm force_disarm)
  # The owner of the rows: they are of vehicles.
  @owner :steering

  @doc """
  Whether a source may steer, by what it asks for of a vehicle's snapshot; from then on it does. `hold_us`: for how
  long the gateway repeats its sticks.
  """
  @spec claim(Names.gateway(), map() | nil, Intent.t(), Roles.source(), hold_us :: non_neg_integer()) ::
          :allow | Refusal.denial()
  def claim(gateway, snapshot, facts, source, hold_us \\ 0)

  def claim(gateway, %{autopilot: firmware, key: key}, %{type: type}, source, hold_us) do
    if Firmware.reading(firmware).steered_by == :channels,
      do: steer(gateway, key, type, source, hold_us),
      else: :allow
  end

  def claim(_gateway, _no_vehicle, _facts, _source, _hold_us), do: :allow

  defp steer(gateway, key, type, _source, _hold_us) when type in @ends do
    now = now()

    update(gateway, key, now, fn
      nil -> {:keep, :allow}
      _somebody -> {:put, :allow, nil, now}
    end)
  end

  defp steer(gateway, key, type, source, hold_us) when is_map_key(@until, type) do
    now = now()
    who = {Map.get(source, :kind), ControlLease.who(source)}
    until = now + @until[type] + hold_us

    update(gateway, key, now, fn
      {^who, _name, before} when type in ["set_mode", "rtl", "hold"] ->
        put(who, max(before, now + @sticks_us))

      {other, name, _until} when other != who ->
        {:keep, Refusal.deny(:steered, command: type, name: name)}

      _own_or_none ->
        put(who, until)
    end)
  end

  defp steer(_gateway, _key, _type, _source, _hold_us), do: :allow

  defp put({_kind, name} = who, until), do: {:put, :allow, {who, name, until}, until}

  defp update(gateway, key, now, fun) do
    with :full <- ClientHistory.update(gateway, {@owner, :steers, key}, now, fun),
         do: Refusal.deny(:steered_many)
  end

  defp now, do: System.monotonic_time(:microsecond)
end

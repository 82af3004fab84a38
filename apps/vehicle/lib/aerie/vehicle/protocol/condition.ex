defmodule Aerie.Vehicle.Protocol.Condition do
  @moduledoc """
  The state of a vehicle that shows that a command was done, as data: an adapter chooses it, the executor checks it.

    * `{:armed, boolean}`, `{:in_air, boolean}`, `{:vtol_state, label}`, `{:mission_seq, n}`
    * `{:mode, [name]}` - one of these modes
    * `{:home, lat, lon, metres}` - home is within this distance of a position
    * `{:booted, count}` - it has rebooted more than `count` times
    * `:told` - its messages report it (`c:Aerie.Vehicle.Protocol.read/4` gives `:done`); its state does not show it
    * `{:any, [condition]}`
  """

  alias Aerie.Vehicle.Protocol.Vehicle

  @type t ::
          {:armed, boolean()}
          | {:in_air, boolean()}
          | {:vtol_state, String.t()}
          | {:mission_seq, non_neg_integer()}
          | {:mode, [String.t(), ...]}
          | {:home, float(), float(), number()}
          | {:booted, non_neg_integer()}
          | :told
          | {:any, [t(), ...]}

  @metres_per_degree 111_320.0

  @doc "Whether the state shows it."
  @spec met?(t(), Vehicle.t()) :: boolean()
  def met?({:armed, armed}, vehicle), do: vehicle.armed == armed
  def met?({:in_air, in_air}, vehicle), do: vehicle.in_air == in_air
  def met?({:vtol_state, state}, vehicle), do: vehicle.vtol_state == state
  def met?({:mission_seq, seq}, vehicle), do: vehicle.mission_seq == seq
  def met?({:mode, modes}, vehicle), do: vehicle.mode in modes
  def met?({:booted, before}, vehicle), do: vehicle.boots > before
  def met?({:any, conditions}, vehicle), do: Enum.any?(conditions, &met?(&1, vehicle))
  def met?(:told, _vehicle), do: false
  def met?({:home, _lat, _lon, _metres}, %{home: nil}), do: false

  def met?({:home, lat, lon, metres}, %{home: home}) do
    north = (home.lat - lat) * @metres_per_degree
    # The short way around the date line.
    turn = :math.fmod(home.lon - lon + 540.0, 360.0) - 180.0
    east = turn * @metres_per_degree * :math.cos(lat * :math.pi() / 180)
    north * north + east * east <= metres * metres
  end

  @doc "Whether the state shows it as soon as it is done, so that a vehicle that does not show it has not done it."
  @spec immediate?(t()) :: boolean()
  def immediate?({kind, _value}) when kind in [:armed, :mode, :mission_seq], do: true
  def immediate?({:any, [first | _others]}), do: immediate?(first)
  def immediate?(_slow), do: false

  @doc "How recent the state is: the latest time at which a value that the condition depends on was heard."
  @spec seen(t(), Vehicle.t()) :: integer() | nil
  def seen({:any, conditions}, vehicle),
    do: conditions |> Enum.map(&seen(&1, vehicle)) |> Enum.reject(&is_nil/1) |> Enum.max(fn -> nil end)

  # Every message shows whether it has booted.
  def seen({:booted, _before}, vehicle), do: vehicle.seen |> Map.values() |> Enum.max(fn -> nil end)
  def seen(condition, vehicle), do: Map.get(vehicle.seen, group(condition))

  defp group({:armed, _armed}), do: :mode
  defp group({:mode, _modes}), do: :mode
  defp group({:in_air, _in_air}), do: :in_air
  defp group({:vtol_state, _state}), do: :vtol
  defp group({:mission_seq, _seq}), do: :mission
  defp group({:home, _lat, _lon, _metres}), do: :home
  defp group(:told), do: nil

  @doc "The present state in words, for a reason: `its mode is GUIDED, not AUTO`."
  @spec describe(t(), Vehicle.t()) :: String.t()
  def describe({:armed, true}, _vehicle), do: "it is not armed"
  def describe({:armed, false}, _vehicle), do: "it is still armed"
  def describe({:in_air, true}, _vehicle), do: "it is not in the air"
  def describe({:in_air, false}, _vehicle), do: "it is still in the air"

  def describe({:mode, modes}, vehicle),
    do: "its mode is #{vehicle.mode || "not known"}, not #{Enum.join(modes, " or ")}"

  def describe({:vtol_state, state}, vehicle),
    do: "its VTOL state is #{vehicle.vtol_state || "not known"}, not #{state}"

  def describe({:mission_seq, seq}, vehicle),
    do: "its current item is #{vehicle.mission_seq || "not known"}, not #{seq}"

  def describe({:home, _lat, _lon, _metres}, %{home: nil}), do: "its home is not known"
  def describe({:home, _lat, _lon, _metres}, _vehicle), do: "its home is elsewhere"
  def describe({:booted, _before}, _vehicle), do: "it was not seen to boot"
  def describe(:told, _vehicle), do: "it did not report the end"
  def describe({:any, [first | _more]}, vehicle), do: describe(first, vehicle)
end

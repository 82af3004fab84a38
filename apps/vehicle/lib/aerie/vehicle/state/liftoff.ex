defmodule Aerie.Vehicle.State.Liftoff do
  @moduledoc """
  Where the vehicle took off: the home that it had then, and the height of the ground. Home may be moved in flight, and with it
  everything that is measured from it; these stay. On the ground they are those of now.
  """

  alias Aerie.Vehicle.State

  @typedoc "`:home` - the last one on the ground, or the first that was heard in the air; `:ground` - metres above mean sea level."
  @type t :: %{home: State.place() | nil, ground: float() | nil}

  @doc "The knowledge after a message."
  @spec next(t() | nil, State.t()) :: t() | nil
  def next(liftoff, state) do
    case State.data(state, :mode).in_air do
      false -> %{home: home(state), ground: State.data(state, :position).alt_msl}
      _flies when liftoff == nil -> %{home: home(state), ground: nil}
      _flies when liftoff.home == nil -> %{liftoff | home: home(state)}
      _flies -> liftoff
    end
  end

  defp home(state) do
    case State.data(state, :home) do
      %{lat: lat, lon: lon, alt_msl: alt} when is_number(lat) and is_number(lon) ->
        %{lat: lat, lon: lon, alt_msl: alt}

      _unknown ->
        nil
    end
  end
end

defmodule Aerie.Fleet.Shadow.Document.Observed do
  @moduledoc "The actual state of a vehicle in the fields of its desired state, read from its snapshot. Pure."

  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.Reconcile
  alias MavCodec.Dialects.All
  alias Aerie.Vehicle.Snapshot

  @typedoc """
  What the snapshot does not show: the desired `:tags` (only the shadow keeps them), and what is known about the
  vehicle's parameters and plans, by path.
  """
  @type beside :: %{optional(Field.path()) => term()}

  @doc "The actual state from a snapshot, for the fields with these paths."
  @spec of(map(), [Field.path()], beside()) :: Reconcile.actual()
  def of(snapshot, paths, beside \\ %{}) do
    mode = Snapshot.data(snapshot, :mode)

    values =
      Map.new(paths, fn path -> {path, Map.get_lazy(beside, path, fn -> field(path, snapshot) end)} end)

    fields = Map.reject(values, fn {_path, value} -> value == nil end)
    %{fields: fields, mode: mode[:mode], armed: mode[:armed], in_air: mode[:in_air]}
  end

  defp field("mode", snapshot), do: Snapshot.data(snapshot, :mode)[:mode]
  defp field("armed", snapshot), do: Snapshot.data(snapshot, :mode)[:armed]
  defp field("geofence.enabled", snapshot), do: Snapshot.data(snapshot, :health)[:fence_enabled]
  defp field("recorder", snapshot), do: match?(%{mode: :always}, snapshot.recording)
  defp field("signing", snapshot), do: match?(%{state: :verified}, snapshot.signing)

  defp field("home", snapshot) do
    case Snapshot.data(snapshot, :home) do
      %{lat: lat, lon: lon, alt_msl: metres} when is_number(lat) and is_number(lon) and is_number(metres) ->
        %{"lat" => lat, "lon" => lon, "altitude_msl" => metres}

      _unknown ->
        nil
    end
  end

  defp field("intervals." <> name, snapshot) do
    case snapshot.streams[All.message_id(name)] do
      %{measured: rate} -> rate
      _not_wanted -> nil
    end
  end

  defp field(_not_in_a_snapshot, _snapshot), do: nil
end

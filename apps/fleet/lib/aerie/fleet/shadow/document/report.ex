defmodule Aerie.Fleet.Shadow.Document.Report do
  @moduledoc """
  The reported document of a vehicle: its state, the state of each desired field, and what holds the shadow off. Pure. Only
  the gateway writes it (Z2); `docs/shadow.md` describes its keys.
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.Core
  alias Aerie.Fleet.Shadow.Document.Observed
  alias Aerie.Vehicle.Snapshot

  # The parts of the health that are states, not measured values that change all the time.
  @health [:unhealthy, :ready_to_arm, :arming_checks, :rc_receiver]
  @always ~w(mode armed geofence.enabled home recorder signing)

  @doc "The fields of the health in it."
  @spec health() :: [atom()]
  def health, do: @health

  @doc "The document without its times. It is published when it differs from the last one."
  @spec document(map(), Core.t(), Observed.beside(), gateway :: String.t()) :: map()
  def document(snapshot, core, beside, gateway) do
    paths = Enum.uniq(@always ++ Map.keys(core.document.fields))
    tags = for {"tags", %{value: tags}} <- core.document.fields, into: beside, do: {"tags", tags}
    actual = Observed.of(snapshot, paths, tags)

    %{} =
      actual.fields
      |> Field.nested()
      |> Map.merge(%{
        "vehicle" => core.vehicle,
        "gateway" => gateway,
        "desired_version" => core.document.version,
        "in_air" => actual.in_air,
        "status" => Atom.to_string(snapshot.status),
        "autopilot" => Atom.to_string(snapshot.autopilot),
        "type" => snapshot.vehicle_type,
        "firmware" => snapshot.firmware,
        "capabilities" => snapshot.capabilities,
        "links" => Enum.sort(for link <- snapshot.links, do: "#{link}"),
        "health" => snapshot |> Snapshot.data(:health) |> Map.take(@health),
        "fields" => fields(core),
        "holds" => for(hold <- core.active, do: plain(hold))
      })
      |> Json.plain()
  end

  @max_bytes 65_536

  @doc "The largest reported document in bytes as JSON."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc """
  The document as it is published, and how many fields it had to leave out to be within `max_bytes/0`: those that agree first, then
  the last ones by name. Their number is in `omitted_fields`.
  """
  @spec bounded(map()) :: {map(), omitted :: non_neg_integer()}
  def bounded(%{"fields" => fields} = document) do
    if fits?(document) do
      {document, 0}
    else
      open = for {path, status} <- fields, status["state"] != "converged", do: path
      shorten(document, Enum.sort(open))
    end
  end

  defp shorten(%{"fields" => fields} = document, paths) do
    omitted = map_size(fields) - length(paths)
    shorter = Map.merge(document, %{"fields" => Map.take(fields, paths), "omitted_fields" => omitted})

    if fits?(shorter) or paths == [],
      do: {shorter, omitted},
      else: shorten(document, Enum.take(paths, div(length(paths), 2)))
  end

  defp fits?(document), do: document |> JSON.encode_to_iodata!() |> IO.iodata_length() <= @max_bytes

  defp fields(core) do
    for {path, status} <- core.report, entry = core.document.fields[path], into: %{} do
      {path, Map.merge(plain(status), %{"desired" => entry.value, "version" => entry.version})}
    end
  end

  defp plain(status) do
    Map.new(status, fn
      {:until, until} -> {"until", Json.time(until)}
      {:state, state} -> {"state", Atom.to_string(state)}
      {key, value} -> {Atom.to_string(key), value}
    end)
  end
end

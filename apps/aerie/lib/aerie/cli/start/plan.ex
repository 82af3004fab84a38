defmodule Aerie.CLI.Start.Plan do
  @moduledoc """
  Decides from the options what `bin/run` starts. Pure.

  Three rules hold for users. Simulated vehicles fly only without `--link`, `--replay` and `--config`, or if `--sim` asks
  for them. The command line overrides the environment, and the environment overrides the file. A replay has NATS and folders of its own
  (`var/replay`), because what is recorded is not the fleet's: a gateway beside it, or the next one, must not find it among its own.
  With `--nats URL` it publishes there, in the environment `replay`.
  """

  alias Aerie.CLI.Start.Options

  @demo_vehicles 3
  @apart %{
    "outbox" => %{"dir" => "var/replay/outbox"},
    "shadow" => %{"dir" => "var/replay/shadow"},
    "tracks" => %{"dir" => "var/replay/tracks"},
    "commands" => %{"ledger" => %{"dir" => "var/replay/ledger"}},
    "policy" => %{"audit" => %{"dir" => "var/replay/audit"}}
  }
  @own_nats %{
    "mode" => "embedded",
    "store_dir" => "var/replay/nats",
    "port" => 0,
    "leaf" => %{"url" => []}
  }

  @type t :: %{
          config_file: String.t() | nil,
          overrides: map(),
          sim: non_neg_integer(),
          sim_msp: non_neg_integer(),
          sim_speed: float()
        }

  @doc """
  Plans a run. Relative paths are relative to `folder`, the user's current directory. `demo?`: simulated vehicles fly where nothing
  else was asked for.
  """
  @spec from(Options.t(), String.t(), demo? :: boolean()) :: t()
  def from(%Options{} = options, folder, demo? \\ true) do
    %{
      config_file: options.config && Path.expand(options.config, folder),
      overrides: %{} |> links(options, folder) |> http(options) |> nats(options) |> apart(options),
      sim: sim(options, demo?),
      sim_msp: options.sim_msp,
      sim_speed: if(options.replay, do: 1.0, else: options.speed)
    }
  end

  defp links(overrides, %{replay: file} = options, folder) when is_binary(file) do
    url = "replay:#{Path.expand(file, folder)}?speed=#{options.speed}"
    # No live vehicle may connect during a replay: it could be taken for part of the recording.
    overrides
    |> Map.put("links", [%{"id" => "replay", "url" => url}])
    |> Map.put("mavlink", %{"local_addr" => "off"})
  end

  defp links(overrides, %{links: []}, _folder), do: overrides

  defp links(overrides, %{links: links}, _folder) do
    Map.put(overrides, "links", Enum.map(links, &%{"url" => &1}))
  end

  defp http(overrides, %{http: nil}), do: overrides
  # The option asks for HTTP, whatever a file says about serving it.
  defp http(overrides, %{http: port}),
    do: Map.put(overrides, "http", %{"enabled" => true, "port" => port})

  defp nats(overrides, %{nats: nil}), do: overrides
  defp nats(overrides, %{nats: "embedded"}), do: Map.put(overrides, "nats", %{"mode" => "embedded"})
  defp nats(overrides, %{nats: url}), do: Map.put(overrides, "nats", %{"mode" => "url", "url" => url})

  # Another gateway's server is not asked for its port, and its hub is not reached by a leaf of ours.
  defp apart(overrides, %{replay: nil}), do: overrides

  defp apart(overrides, %{nats: nats}) do
    overrides = Map.merge(overrides, @apart)

    if nats in [nil, "embedded"],
      do: Map.put(overrides, "nats", @own_nats),
      else: Map.put(overrides, "environment", "replay")
  end

  defp sim(%{sim: count}, _demo?) when is_integer(count), do: count
  defp sim(%{links: [], replay: nil, config: nil}, true), do: @demo_vehicles
  defp sim(_options, _demo?), do: 0
end

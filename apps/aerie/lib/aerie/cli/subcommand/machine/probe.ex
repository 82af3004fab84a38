defmodule Aerie.CLI.Subcommand.Machine.Probe do
  @moduledoc """
  `aerie probe`: finds out what is connected to a serial port or an address. A temporary gateway without NATS, HTTP and stored data
  listens there for a few seconds; then its read model is printed. It asks a vehicle for its version, and sends no commands.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.{Config, Gateway}
  alias Aerie.Base.{Json, Store}
  alias Aerie.Fleet.Inspector
  alias MavRouter.Link
  alias MavRouter.Link.Spec
  alias Aerie.Base.PubSub
  alias Aerie.CLI.Output.Columns

  @default_s 5.0
  @longest_s 3600

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"PORT|URL" => place}, options: options}) do
    seconds = options[:seconds] || @default_s

    with {:seconds, true} <- {:seconds, seconds > 0 and seconds <= @longest_s},
         {:ok, url} <- url(place) do
      {:ok, _started} = Application.ensure_all_started([:fleet, :fast_yaml])
      report = listen(url, round(seconds * 1000))
      {status(report), if(options[:json], do: [Json.encode_to_iodata!(report), ?\n], else: render(report))}
    else
      {:seconds, false} -> {:error, "--seconds: expected a number above 0 and up to #{@longest_s}"}
      {:error, text} -> {:error, text}
    end
  end

  # A device alone is a serial port whose rate is searched for.
  defp url(place) do
    url =
      if String.starts_with?(place, "/") and not String.contains?(place, ","),
        do: "serial:" <> place,
        else: place

    case Spec.parse(url) do
      {:ok, spec} -> {:ok, spec.text}
      {:error, error} -> {:error, Exception.message(error)}
    end
  end

  defp listen(url, ms) do
    folder = Path.join(System.tmp_dir!(), "aerie-probe-#{System.pid()}")
    :ok = Aerie.Base.Files.Private.folder(folder)
    gateway = make_ref()
    {:ok, pid} = Gateway.start_link(name: gateway, config: config(url, folder))
    PubSub.subscribe(gateway, :links)
    # Otherwise the console has one.
    {:ok, _inspector} = Inspector.start_link(gateway: gateway)
    _ = Inspector.watch(gateway)
    await(gateway, System.monotonic_time(:millisecond) + ms)
    report = report(gateway, url)
    Process.unlink(pid)
    :ok = Gateway.stop(gateway)
    _ = File.rm_rf(folder)
    report
  end

  defp config(url, folder) do
    Config.default(%{
      "links" => [%{"id" => "probe", "url" => url}],
      "mavlink" => %{"local_addr" => "off"},
      "clients" => [],
      "nats" => %{"mode" => "off"},
      "http" => %{"enabled" => false},
      "websocket" => %{"enabled" => false},
      "sockets" => %{"enabled" => false},
      "signing" => %{"dir" => Path.join(folder, "signing")},
      "recorder" => %{"dir" => Path.join(folder, "recordings"), "links" => "off", "vehicles" => "off"},
      "outbox" => %{"dir" => Path.join(folder, "outbox")},
      "commands" => %{"ledger" => %{"dir" => Path.join(folder, "ledger")}},
      "policy" => %{"audit" => %{"dir" => Path.join(folder, "audit")}},
      "params" => %{"dir" => Path.join(folder, "params")},
      "shadow" => %{"dir" => Path.join(folder, "shadow")}
    })
  end

  # The time starts again when the first frame is heard, because the search for the rate takes seconds. This happens once.
  defp await(gateway, until, heard? \\ false) do
    left = until - System.monotonic_time(:millisecond)

    receive do
      {:fleet, :links, _changed} when left > 0 ->
        if not heard? and match?(%{last_heard: at} when at != nil, Store.link(gateway, "probe")),
          do: await(gateway, until + 1_000, true),
          else: await(gateway, until, heard?)
    after
      max(left, 0) -> :ok
    end
  end

  defp report(gateway, url) do
    link = Link.get(gateway, "probe") || %{}

    %{
      url: url,
      status: link[:status],
      text: link[:text],
      baud: link[:baud],
      frames: get_in(link, [:counters, Access.key(:frames_in)]) || 0,
      crc_errors: get_in(link, [:counters, Access.key(:crc_errors)]) || 0,
      protocol: protocol(link),
      found: for(finding <- link[:diagnosis] || [], do: Link.Serial.Finding.format(finding)),
      vehicles: for(v <- Store.vehicles(gateway), do: vehicle(v)),
      messages:
        for %{key: {_link, :in, system, component, _id}, name: name, hz: hz, count: count} <-
              Inspector.rows(gateway) do
          %{
            system: system,
            component: component,
            name: name,
            hz: Float.round(hz * 1.0, 1),
            count: count
          }
        end
    }
  end

  defp protocol(%{counters: %{frames_in: n}}) when n > 0, do: "MAVLink"
  defp protocol(_link), do: nil

  defp vehicle(vehicle) do
    %{
      system: vehicle.system_id,
      component: vehicle.component,
      autopilot: vehicle.autopilot,
      type: vehicle.vehicle_type,
      firmware: Json.plain(vehicle.firmware)
    }
  end

  defp status(%{vehicles: [_ | _]}), do: 0
  defp status(%{frames: n}) when n > 0, do: 0
  defp status(%{status: :down}), do: 2
  defp status(_silent), do: 1

  @doc "The report as text. Pure."
  @spec render(map()) :: iodata()
  def render(report) do
    [
      "#{report.url}: #{Columns.cell(report.text)}\n",
      if(report.baud, do: "baud rate #{report.baud}\n", else: []),
      if(report.protocol,
        do: "#{report.protocol}: #{report.frames} frames, #{report.crc_errors} with a wrong checksum\n",
        else: "no MAVLink was heard\n"
      ),
      for(line <- report.found, do: [Columns.cell(line), ?\n]),
      if(report.vehicles != [],
        do: [
          "\n",
          Columns.render(
            ~w(SYSTEM COMPONENT AUTOPILOT TYPE FIRMWARE),
            for(v <- report.vehicles, do: [v.system, v.component, v.autopilot, v.type, firmware(v.firmware)])
          )
        ],
        else: []
      ),
      if(report.messages != [],
        do: [
          "\n",
          Columns.render(
            ~w(SYSTEM COMPONENT MESSAGE PER-SECOND COUNT),
            for(m <- report.messages, do: [m.system, m.component, m.name, m.hz, m.count])
          )
        ],
        else: []
      )
    ]
  end

  defp firmware(nil), do: nil
  defp firmware(text) when is_binary(text), do: text
  defp firmware(%{} = map), do: map["version"] || map[:version] || Json.encode!(map)
  defp firmware(other), do: inspect(other)
end

defmodule Aerie.CLI.Subcommand.Machine.Doctor do
  @moduledoc """
  `aerie doctor`: checks whether this machine has what a gateway with this configuration needs. Each finding is ok, a
  warning or an error, and says how to fix it. If a gateway is running, the findings of its own diagnosis
  (`Aerie.Fleet.Diagnosis`) are included.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Files.Disk
  alias Aerie.Config
  alias Aerie.Config.Preflight
  alias Aerie.Base.Net.SerialPorts
  alias Aerie.CLI.{Gateway, Subcommand}
  alias Aerie.CLI.Output.Columns

  @type finding :: %{
          what: String.t(),
          level: :ok | :warning | :error,
          text: String.t(),
          mend: String.t() | nil
        }

  # Two minutes of a busy fleet's recording, and room for NATS.
  @low_disk 512 * 1024 * 1024

  @impl Aerie.CLI.Subcommand
  def run(%{options: options} = request) do
    running = running(request)

    findings =
      case Subcommand.Machine.Config.load(request) do
        {:ok, config} ->
          configuration(config, running) ++ machine(config) ++ nats(config.nats) ++ gateway(running)

        {:error, errors} ->
          errors(errors)
      end

    text = if options[:json], do: [JSON.encode_to_iodata!(findings), ?\n], else: render(findings)
    {if(Enum.any?(findings, &(&1.level == :error)), do: 1, else: 0), text}
  end

  @doc "Findings as text, the serious ones first. Pure."
  @spec render([finding()]) :: iodata()
  def render(findings) do
    for finding <-
          Enum.sort_by(findings, &Enum.find_index([:error, :warning, :ok], fn level -> level == &1.level end)) do
      [
        "#{String.pad_trailing(Atom.to_string(finding.level), 8)} #{finding.what}: #{Columns.cell(finding.text)}\n",
        if(finding.mend, do: "         fix: #{Columns.cell(finding.mend)}\n", else: [])
      ]
    end
  end

  # A running gateway has its ports itself.
  defp configuration(config, []) do
    case Preflight.check(config) do
      {:ok, warnings} ->
        [
          ok("configuration", config.file || "the defaults")
          | Enum.map(config.warnings ++ warnings, &warning("configuration", &1))
        ]

      {:error, errors} ->
        errors(errors)
    end
  end

  defp configuration(config, _running),
    do: [
      ok("configuration", config.file || "the defaults")
      | Enum.map(config.warnings, &warning("configuration", &1))
    ]

  defp errors(errors), do: for(error <- errors, do: error("configuration", Config.Error.format(error)))

  @doc "What is found about the machine: serial ports, ModemManager, the clock, the disks."
  @spec machine(Config.t()) :: [finding()]
  def machine(config),
    do:
      serial(config) ++ modem_manager("/proc") ++ clock("/run/systemd/timesync/synchronized") ++ disk(config)

  defp serial(config) do
    links = devices(config.links)

    case SerialPorts.list(%{ports: config.serial.ports}) do
      [] when links == [] -> [ok("serial ports", "none is plugged in")]
      ports -> Enum.map(ports, &port/1) ++ links
    end
  end

  @doc "What is wrong with the devices of configured links: without its own a link waits for ever."
  @spec devices([map()]) :: [finding()]
  def devices(links) do
    for %{id: id, enabled: true, spec: %{device: "" <> device}} <- links,
        path = Path.expand(device, "/dev"),
        {:error, posix} <- [File.stat(path)] do
      error(
        "link #{id}",
        "#{path}: #{:file.format_error(posix)}",
        "plug it in, or correct the link's url; aerie probe #{path} says what speaks there"
      )
    end
  end

  defp port(%{path: path}) do
    case File.stat(path) do
      {:ok, %{access: :read_write}} ->
        ok("serial port", path)

      {:ok, _stat} ->
        error("serial port", "#{path}: no permission", "sudo usermod -aG dialout USER, then sign in again")

      {:error, posix} ->
        warning(
          "serial port",
          "#{path}: #{:file.format_error(posix)}",
          "plug it in, or remove it from the configuration"
        )
    end
  end

  @doc "Whether ModemManager runs, by the processes in a folder such as /proc: it writes to new serial ports."
  @spec modem_manager(Path.t()) :: [finding()]
  def modem_manager(proc) do
    names =
      for file <- Path.wildcard(Path.join(proc, "[0-9]*/comm")),
          {:ok, name} <- [File.read(file)],
          do: String.trim(name)

    if "ModemManager" in names,
      do: [
        warning(
          "ModemManager",
          "it is running, and writes to every new serial port, also to a flight controller's",
          "sudo systemctl mask --now ModemManager, or a udev rule with ENV{ID_MM_DEVICE_IGNORE}=\"1\""
        )
      ],
      else: [ok("ModemManager", "not running")]
  end

  @doc "Whether the clock is right, as far as can be seen: the year, and systemd's mark where systemd keeps the time."
  @spec clock(Path.t(), integer()) :: [finding()]
  def clock(mark, now_s \\ System.os_time(:second)) do
    cond do
      now_s < 1_735_689_600 ->
        [
          error(
            "clock",
            "#{DateTime.from_unix!(now_s)} is long past: signing and NATS need the right time",
            "set it: timedatectl set-ntp true, or a GPS"
          )
        ]

      File.dir?(Path.dirname(mark)) and not File.exists?(mark) ->
        [warning("clock", "systemd has not set it from the network yet", "timedatectl status shows why")]

      true ->
        [ok("clock", "#{DateTime.from_unix!(now_s)}")]
    end
  end

  defp disk(config) do
    for dir <- Enum.uniq([existing(config.nats.store_dir), existing(config.recorder.dir)]) do
      case Disk.free(dir) do
        {:ok, bytes} when bytes < @low_disk ->
          warning(
            "disk",
            "#{div(bytes, 1_048_576)} MB free in #{dir}",
            "remove old recordings, or name another folder (recorder.dir, nats.store_dir)"
          )

        {:ok, bytes} ->
          ok("disk", "#{div(bytes, 1_048_576)} MB free in #{dir}")

        :unknown ->
          warning("disk", "#{dir}: the free space cannot be determined", "df #{dir}")
      end
    end
  end

  # The configuration's check has looked for the embedded program.
  defp nats(%{mode: :url, url: urls}), do: Enum.map(urls, &server/1)
  defp nats(%{mode: mode}), do: [ok("NATS", "#{mode}")]

  defp server(url) do
    %URI{host: host, port: port} = URI.parse(url)

    case :gen_tcp.connect(String.to_charlist(host), port || 4222, [], 2_000) do
      {:ok, socket} ->
        :gen_tcp.close(socket)
        ok("NATS", "#{url} answers")

      {:error, reason} ->
        warning(
          "NATS",
          "#{url}: #{:inet.format_error(reason)}; events wait on the disk",
          "start it, or correct nats.url"
        )
    end
  end

  # A missing folder will be made on the disk of the folder above.
  defp existing(dir) do
    dir = Path.expand(dir)
    if File.dir?(dir) or dir == "/", do: dir, else: existing(Path.dirname(dir))
  end

  defp running(request) do
    with {:ok, entries} <- Aerie.Node.list(Gateway.dir(request)), do: entries, else: (_unreadable -> [])
  end

  defp gateway([]), do: [ok("gateway", "none is running")]

  defp gateway([entry | _others]) do
    request = %{options: %{gateway: entry.name}, folder: "."}

    with {:ok, node, _entry} <- Gateway.connect(request),
         conditions when is_list(conditions) <- Gateway.call(node, Aerie.Fleet.Diagnosis, :list, [:default]) do
      [
        ok("gateway", "#{entry.name} has been running since #{entry.started}")
        | Enum.map(conditions, &condition/1)
      ]
    else
      {:error, text} -> [error("gateway", text, "aerie stop, then start it again")]
      _other -> [warning("gateway", "#{entry.name} does not answer", "look at its log")]
    end
  end

  defp condition(condition) do
    level = if condition.severity == :error, do: :error, else: :warning
    %{what: subject(condition.subject), level: level, text: condition.title, mend: condition.mend}
  end

  defp subject({kind, id}), do: "#{kind} #{id}"
  defp subject(kind), do: to_string(kind)

  defp ok(what, text), do: %{what: what, level: :ok, text: text, mend: nil}
  defp warning(what, text, mend \\ nil), do: %{what: what, level: :warning, text: text, mend: mend}
  defp error(what, text, mend \\ nil), do: %{what: what, level: :error, text: text, mend: mend}
end

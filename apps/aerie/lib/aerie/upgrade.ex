defmodule Aerie.Upgrade do
  @moduledoc """
  The part of an upgrade that the running gateway does: it says what would be lost, starts the program of the other
  version, which waits (`Aerie.Upgrade.Standby`), and ends for it. `aerie upgrade` calls these functions, of another
  version perhaps: their names, arguments and answers stay as they are.

  The waiting one is a child of nobody but init, in the service's control group, with the same user, environment, words
  and output. systemd hears that it is the service's main process before this one ends (`MAINPID`, `sd_notify(3)`).
  """

  alias Aerie.Base.Files.Private
  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Commands.Recent
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Fleet.Operations
  alias Aerie.Systemd
  alias Aerie.Upgrade.Standby
  alias MavRouter.Sharing.TransferLock

  @typedoc "The waiting gateway: its process, and the folder of the files that it reads."
  @type standby :: %{pid: String.t(), folder: Path.t()}

  @sticks ~w(rc_override manual_control)
  # Sticks come at 5 Hz or more.
  @steered_us 2_000_000
  @tick_ms 20
  # A slow card and a full disk cache; it waits for nothing else.
  @ready_ms 120_000
  # The runtime's own, which its script sets again.
  @runtime ~w(ROOTDIR BINDIR EMU PROGNAME)

  @doc """
  What would be lost if the gateway ended now, each as a line for a person. State, events, desired states, recordings
  and the results of commands are not among it: they are on the disk, in NATS or come again from the vehicle.
  """
  @spec obstacles(Names.gateway()) :: [String.t()]
  def obstacles(gateway) do
    turns = Enum.group_by(TransferLock.turns(gateway), &elem(&1, 0), &elem(&1, 1))

    vehicles =
      for vehicle <- Store.vehicles(gateway),
          text <- obstacles(gateway, vehicle, turns),
          do: "#{vehicle.id}: #{text}"

    operations =
      for %{"state" => "running", "id" => id} <- Operations.list(gateway), do: "operation #{id} is under way"

    vehicles ++ operations
  end

  defp obstacles(gateway, %{id: id, key: key}, turns) do
    commands =
      for %{type: type, source: source} <- Recent.of(gateway, id, 0), do: "#{type} of #{source} is under way"

    transfers = for kind <- Map.get(turns, key, []), do: "a transfer (#{kind}) is under way"
    commands ++ transfers ++ steered(gateway, id) ++ in_charge(gateway, key)
  end

  # It would miss them for a second, which may be its failsafe.
  defp steered(gateway, id) do
    cond do
      RecentCommands.setpoints_ms(gateway, id) != nil ->
        ["set-points steer it"]

      sticks = sticks(RecentCommands.last(gateway, id)) ->
        ["#{sticks} steers it by its sticks"]

      true ->
        []
    end
  end

  defp sticks(%{type: type, source: source, at: at}) when type in @sticks,
    do: if(System.os_time(:microsecond) - at < @steered_us, do: source)

  defp sticks(_other), do: nil

  defp in_charge(gateway, key) do
    case Holders.of(gateway, key) do
      %{holder: holder, offered_to: offered} when offered != :anyone -> ["#{holder} is in charge of it"]
      _nobody -> []
    end
  end

  @doc """
  Starts the gateway of `program` (a release's `bin/aerie`) beside this one, and waits until it is ready to take its
  place. Files are made below `dir`.
  """
  @spec begin(program :: Path.t(), dir :: Path.t()) :: {:ok, standby()} | {:error, String.t()}
  def begin(program, dir), do: with(:ok <- release(), do: beside(program, dir))

  @doc false
  # From whatever this gateway runs.
  @spec beside(Path.t(), Path.t()) :: {:ok, standby()} | {:error, String.t()}
  def beside(program, dir) do
    folder = Path.join(dir, "upgrade-#{System.pid()}")
    with :ok <- claim(folder), do: await(start(program, folder), folder, @ready_ms)
  end

  # One at a time: the folder is there as long as another version waits.
  defp claim(folder) do
    case File.mkdir(folder) do
      :ok ->
        File.chmod(folder, 0o700)

      {:error, :eexist} ->
        if waits?(folder), do: {:error, "another upgrade is under way"}, else: claim_left(folder)

      {:error, posix} ->
        {:error, "#{folder}: #{:file.format_error(posix)}"}
    end
  end

  defp claim_left(folder) do
    _ = File.rm_rf(folder)
    claim(folder)
  end

  # One that has only begun has not written its process.
  defp waits?(folder) do
    case {File.read(Path.join(folder, "process")), File.stat(folder, time: :posix)} do
      {{:ok, pid}, _stat} -> File.exists?("/proc/#{String.trim(pid)}")
      {_none, {:ok, %File.Stat{mtime: at}}} -> System.os_time(:second) - at < div(@ready_ms, 1000)
      {_none, _gone} -> false
    end
  end

  defp release do
    case :init.get_argument(:boot) do
      {:ok, [[boot]]} when boot != [] ->
        if Path.basename(List.to_string(boot)) == "start", do: :ok, else: no_release()

      _none ->
        no_release()
    end
  end

  defp no_release, do: {:error, "this gateway runs from a checkout: end it, and start it again"}

  # It outlives this one, and writes where this one writes. Its process id is that of setsid.
  defp start(program, folder) do
    script =
      ~S(exec 3>&- 4>&-; folder=$1; shift; setsid "$0" start "$@" </dev/null & echo $! >"$folder/process")

    words = Enum.map(:init.get_plain_arguments(), &List.to_string/1)

    path =
      System.get_env("PATH", "")
      |> String.split(":")
      |> Enum.reject(&(&1 == Path.join(:code.root_dir(), "bin")))

    environment =
      [{"PATH", Enum.join(path, ":")} | Standby.environment(folder, System.pid())] ++
        for(name <- @runtime, do: {name, nil})

    {_no_output, 0} =
      System.cmd("/bin/sh", ["-c", script, program, folder | words], env: environment, use_stdio: false)

    folder |> Path.join("process") |> File.read!() |> String.trim()
  end

  defp await(pid, folder, left) when left <= 0 do
    cancel(%{pid: pid, folder: folder})

    {:error,
     "the other version was not ready within #{div(@ready_ms, 1000)} s; its output is in this gateway's log"}
  end

  defp await(pid, folder, left) do
    runs? = File.exists?("/proc/#{pid}")

    case {File.exists?(Path.join(folder, "ready")), File.read(Path.join(folder, "failed"))} do
      {true, _failed} ->
        {:ok, %{pid: pid, folder: folder}}

      {false, {:ok, text}} ->
        _ = File.rm_rf(folder)
        {:error, text}

      {false, _none} when runs? ->
        Process.sleep(@tick_ms)
        await(pid, folder, left - @tick_ms)

      {false, _none} ->
        _ = File.rm_rf(folder)
        {:error, "the other version ended at once; its output is in this gateway's log"}
    end
  end

  @doc "Ends this gateway in order, for the one that waits."
  @spec leave(standby()) :: :ok | {:error, String.t()}
  def leave(%{pid: pid, folder: folder}) do
    with true <- File.exists?("/proc/#{pid}"),
         :ok <- Private.write(Path.join(folder, "go"), "") do
      :ok = Systemd.main_process(pid)
      System.stop()
    else
      false -> {:error, "the other version has ended; its output is in this gateway's log"}
      {:error, posix} -> {:error, "#{folder}: #{:file.format_error(posix)}"}
    end
  end

  @doc "Ends the one that waits."
  @spec cancel(standby()) :: :ok
  def cancel(%{pid: pid, folder: folder}) do
    _ = System.cmd("kill", ["-KILL", pid], stderr_to_stdout: true)
    _ = File.rm_rf(folder)
    :ok
  end
end

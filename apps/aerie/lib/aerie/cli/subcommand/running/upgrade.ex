defmodule Aerie.CLI.Subcommand.Running.Upgrade do
  @moduledoc """
  `aerie upgrade`: puts another version in the place of the running gateway (`Aerie.Upgrade`).

  The program of the other version does it, so that a fault here is mended by the version that mends it: the one in force unpacks a tarball
  and calls the `install.sh` in it, or calls the former one's `bin/aerie`.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Gateway
  alias Aerie.Upgrade.{Tarball, Versions}

  # What was wrong is in the way, and may be over later.
  @refused 4
  @started_ms 60_000
  @tick_ms 20

  @impl Aerie.CLI.Subcommand
  def run(request), do: run(request, to_string(:code.root_dir()))

  @doc false
  # `root`: the folder of the release that this program is of.
  @spec run(Aerie.CLI.Subcommand.request(), Path.t()) :: {0..255, iodata()} | {:error, String.t()}
  def run(%{options: options, arguments: arguments} = request, root) do
    with {:ok, versions} <- Versions.find(root) do
      case {arguments["FILE"], options} do
        {nil, %{take_over: true}} -> take_over(versions, request)
        {nil, %{back: true}} -> call(versions.former, "no earlier version is installed", options)
        {nil, _} -> call(versions.next, "no other version was installed: name its tarball", options)
        {_file, %{back: true}} -> {:error, "a tarball, or --back"}
        {file, _} -> Tarball.install(Path.expand(file, request.folder), versions, words(options))
      end
    end
  end

  defp call(nil, text, _options), do: {:error, text}

  defp call(version, _text, options) do
    {_output, status} =
      System.cmd(Path.join(version, "bin/aerie"), ["upgrade", "--take-over" | words(options)],
        into: IO.stream()
      )

    {status, ""}
  end

  defp words(options), do: if(options[:now], do: ["--now"], else: [])

  # From here on this is the program of the other version.
  defp take_over(versions, request) do
    case Gateway.connect(request) do
      {:ok, node, entry} ->
        with root when is_list(root) <- Gateway.call(node, :code, :root_dir, []) do
          versions = Versions.running(versions, List.to_string(root))

          if versions.current == versions.own,
            do: {0, "#{name(versions)} runs already\n"},
            else: replace(node, entry, versions, request)
        end

      {3, _none_runs} ->
        with :ok <- Versions.put_in_force(versions),
             do: {0, "no gateway runs; #{name(versions)} is in force\n"}

      other ->
        other
    end
  end

  defp replace(node, entry, versions, request) do
    with :ok <- nothing_lost(node, request.options),
         {:ok, standby} <- begin(node, versions, request) do
      # Something may have begun meanwhile.
      with :ok <- nothing_lost(node, request.options),
           :ok <- Versions.put_in_force(versions),
           :ok <- leave(node, standby) do
        started(entry, standby, versions, request)
      else
        answer ->
          _ = Gateway.call(node, Aerie.Upgrade, :cancel, [standby])
          _ = Versions.undo(versions)
          answer
      end
    end
  end

  defp nothing_lost(_node, %{now: true}), do: :ok

  defp nothing_lost(node, _options) do
    case Gateway.call(node, Aerie.Upgrade, :obstacles, [:default]) do
      [] ->
        :ok

      [_ | _] = obstacles ->
        {@refused,
         [
           "Nothing was changed, because this would be lost:\n",
           for(text <- obstacles, do: ["  ", text, "\n"]),
           "Try again when it is over, or do it all the same with --now.\n"
         ]}

      {:error, _text} = error ->
        error
    end
  end

  defp begin(node, versions, request) do
    IO.puts("#{name(versions)} starts beside the gateway")
    program = Path.join(versions.own, "bin/aerie")

    with {:error, text} <- Gateway.call(node, Aerie.Upgrade, :begin, [program, Gateway.dir(request)]),
         do: {:error, "#{String.trim(text)}; nothing was changed"}
  end

  defp leave(node, standby) do
    IO.puts("the gateway hands over")

    case Gateway.call(node, Aerie.Upgrade, :leave, [standby]) do
      # Its connection may end before its answer comes.
      {:error, "the gateway has ended"} -> :ok
      answer -> answer
    end
  end

  defp started(entry, standby, versions, request) do
    ended = await(fn -> not File.exists?("/proc/#{entry.pid}") end, :infinity)
    dir = Gateway.dir(request)
    name = "aerie-#{standby.pid}"
    up? = fn -> File.exists?(Path.join(dir, name <> ".gateway")) end
    gone? = fn -> not File.exists?("/proc/#{standby.pid}") end

    case await(fn -> up?.() or gone?.() end, @started_ms) do
      :timeout ->
        {:error,
         "#{name(versions)} has the place, and has not started within #{div(@started_ms, 1000)} s: see its log; aerie upgrade --back"}

      at ->
        if up?.() do
          Versions.remove_others(versions)

          {0,
           "#{name(versions)} runs as process #{standby.pid}, #{at - ended} ms after the former one ended; aerie upgrade --back undoes it\n"}
        else
          _ = Versions.undo(versions)

          {:error,
           "#{name(versions)} ended at once, see its log; the former version is in force again, and the service manager starts it"}
        end
    end
  end

  # The time (ms) at which it was so.
  defp await(so?, left) do
    cond do
      so?.() -> System.monotonic_time(:millisecond)
      left != :infinity and left <= 0 -> :timeout
      true -> later(so?, left)
    end
  end

  defp later(so?, left) do
    Process.sleep(@tick_ms)
    await(so?, if(left == :infinity, do: left, else: left - @tick_ms))
  end

  defp name(versions), do: Path.basename(versions.own)
end

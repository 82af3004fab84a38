defmodule Aerie.Reload do
  @moduledoc """
  Reads the configuration of a running gateway again and puts in force what can change without a restart: links and clients, the
  policy and its fences, the log. A link whose keys are the same is not touched.

      Aerie.Reload.run(:default, "me")

  The whole file is checked first: with an error anywhere nothing changes. Keys of other parts count from the next start on; they
  are named in the answer. Links and clients that were added at run time stay.
  """
  use GenServer

  require Logger

  alias Aerie.Base.{Log, Names}
  alias Aerie.Config
  alias Aerie.Control.Policy
  alias MavRouter.{Client, Link}
  alias Aerie.Control.Policy.Audit
  alias Aerie.Reload.Changes

  # Links are stopped and started one after the other; each waits for its first attempt.
  @patience_ms 120_000

  @typedoc """
  `needs_restart`: keys that changed and count from the next start on; `failed`: what could not be opened, and why. The lists
  have ids.
  """
  @type report :: %{
          links: %{added: [String.t()], removed: [String.t()], changed: [String.t()]},
          clients: %{added: [String.t()], removed: [String.t()], changed: [String.t()]},
          needs_restart: [String.t()],
          failed: [%{what: String.t(), reason: String.t()}]
        }

  @doc """
  Options: `:gateway`, `:config` (as it was loaded), `:read` (loads it again), `:log?` (whether the log of the VM is this gateway's).
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :reload))

  @doc "Reads and applies the configuration. `by` is who asked for it, for log and audit log."
  @spec run(Names.gateway(), by :: String.t()) :: {:ok, report()} | {:error, [String.t(), ...]}
  def run(gateway, by) when is_binary(by) do
    GenServer.call(Names.via(gateway, :reload), {:run, by}, @patience_ms)
  catch
    :exit, {:noproc, _call} -> {:error, ["the gateway does not run"]}
  end

  @doc "The configuration that is in force: that of the start, which is given, with what was reloaded since."
  @spec in_force(Names.gateway(), Config.t()) :: Config.t()
  def in_force(gateway, start), do: Changes.in_force(start, Names.value(gateway, :reload) || start)

  @impl GenServer
  def init(options) do
    Process.set_label({:reload, options[:gateway]})
    {:ok, options |> Map.new() |> share()}
  end

  defp share(state) do
    Names.put_value(state.gateway, :reload, state.config)
    state
  end

  @impl GenServer
  def handle_call({:run, by}, _from, state) do
    case state.read.() do
      {:ok, config} -> apply_changes(state, config, by)
      {:error, errors} -> {:reply, refused(state, Enum.map(errors, &Config.Error.format/1), by), state}
    end
  end

  defp apply_changes(state, config, by) do
    # A policy that does not compile leaves everything as it is.
    case Policy.Store.reload(state.gateway, by) do
      :ok ->
        changes = Changes.between(state.config, config)
        if state[:log?] && changes.log?, do: Log.configure(Log.Settings.from(config))
        links = change(changes.links, &Link.stop(state.gateway, &1.id), &Link.start(state.gateway, &1))

        clients =
          change(
            changes.clients,
            &Client.remove(state.gateway, &1.id),
            &Client.add(state.gateway, client(&1))
          )

        report = report(changes, links ++ clients)
        log_report(state, report, by)
        {:reply, {:ok, report}, share(%{state | config: without(config, report.failed)})}

      {:error, lines} ->
        {:reply, refused(state, lines, by), state}
    end
  end

  # First what gives ports free, then what takes them. Gives what failed.
  defp change(entries, stop, start) do
    Enum.each(entries.removed ++ entries.changed, stop)

    for entry <- entries.changed ++ entries.added, {:error, error} <- [start.(entry)] do
      %{what: entry.id, reason: if(is_exception(error), do: Exception.message(error), else: inspect(error))}
    end
  end

  defp client(entry), do: Map.drop(entry, [:enabled, :given, :spec])

  defp report(changes, failed) do
    ids = fn entries ->
      Map.new(entries, fn {what, list} -> {what, list |> Enum.map(& &1.id) |> Enum.sort()} end)
    end

    %{
      links: ids.(changes.links),
      clients: ids.(changes.clients),
      needs_restart: changes.restart,
      failed: failed
    }
  end

  # The next time it is tried again.
  defp without(config, failed) do
    gone = for %{what: id} <- failed, do: id

    clients =
      if is_list(config.clients), do: Enum.reject(config.clients, &(&1.id in gone)), else: config.clients

    %{config | links: Enum.reject(config.links, &(&1.id in gone)), clients: clients}
  end

  defp log_report(state, report, by) do
    level = if report.failed == [], do: :info, else: :error

    Logger.log(level, "configuration reloaded",
      fields: [by: by] ++ Enum.map(report, fn {k, v} -> {k, format(v)} end)
    )

    Audit.note(state.gateway, %{"type" => "configuration", "loaded" => true, "source" => by})
  end

  defp format(list) when is_list(list), do: if(list != [], do: Enum.map_join(list, ",", &format/1))
  defp format(%{what: id, reason: reason}), do: "#{id}: #{reason}"
  defp format(%{} = lists), do: Map.new(lists, fn {key, list} -> {key, format(list)} end)
  defp format(text), do: text

  defp refused(state, lines, by) do
    Logger.error("configuration not reloaded (#{by}), the old one stays in force: " <> Enum.join(lines, "; "))

    Audit.note(state.gateway, %{
      "type" => "configuration",
      "loaded" => false,
      "source" => by,
      "reason" => Enum.join(lines, "; ")
    })

    {:error, lines}
  end
end

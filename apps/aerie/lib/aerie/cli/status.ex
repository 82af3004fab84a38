defmodule Aerie.CLI.Status do
  @moduledoc """
  Shows a running gateway in the terminal that started it: a table that is redrawn twice a second, or log lines
  (`Aerie.CLI.Status.Lines.due/3`) if the output is a pipe. It reads the store and subscribes to the events. No other
  process waits for it.
  """

  use GenServer

  alias Aerie.Base.Log
  alias Aerie.Base.Log.Formatter
  alias Aerie.Base.PubSub
  alias Aerie.Access.Launch
  alias Aerie.CLI.Status.{Access, Format, Lines, Table, View}

  @table_period 500
  @lines_period 5_000
  @kept_notes 6

  @doc """
  Options: `gateway` (name of the instance), `style` (`:table` or `:lines`), `http` (address to show, or nil),
  `config` (for its warnings, and for the users of each interface), `device` (where to write, default standard
  output), `size` (`{columns, lines}`).
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, Map.new(options))

  @impl GenServer
  def init(options) do
    Process.set_label({:aerie, :status})
    PubSub.subscribe(options.gateway, :events)

    state =
      Map.merge(
        %{
          device: :stdio,
          size: {100, 40},
          http: nil,
          config: nil,
          interfaces: nil,
          started: System.os_time(:microsecond),
          notes: [],
          told: nil,
          drawn: 0
        },
        options
      )

    {:ok, schedule(state, 100)}
  end

  @impl GenServer
  def handle_info(:show, %{style: :table} = state) do
    {columns, lines} = state.size
    drawn = Table.render(view(state), columns, lines)

    # Redraws in place without flicker: cursor home, each line cleared to its end, then the rest of the screen.
    IO.write(state.device, [first_draw(state), "\e[H", Enum.map(drawn, &[&1, "\e[K\r\n"]), "\e[J"])
    {:noreply, schedule(%{state | drawn: length(drawn)}, @table_period)}
  end

  def handle_info(:show, state) do
    view = view(state)
    # The list of open interfaces is printed only when it has changed.
    interfaces =
      if view.interfaces == state.interfaces,
        do: [],
        else: Lines.console(state.http, state.config) ++ Enum.map(view.interfaces, &Lines.interface/1)

    {lines, told} = view |> Lines.render() |> Lines.due(state.told, System.monotonic_time(:millisecond))
    write_lines(state, interfaces ++ lines)
    {:noreply, schedule(%{state | interfaces: view.interfaces, told: told}, @lines_period)}
  end

  def handle_info({:fleet, :events, event}, %{style: :lines} = state) do
    write_lines(state, [Lines.event(event)])
    {:noreply, state}
  end

  def handle_info({:fleet, :events, event}, state) do
    note = Format.text("#{clock(event.time)}  #{Lines.note(event)}")
    {:noreply, %{state | notes: Enum.take([note | state.notes], @kept_notes)}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp listed(gateway) do
    case Aerie.Control.Policy.Store.get(gateway) do
      nil -> []
      policy -> policy.clients
    end
  end

  defp view(%{gateway: gateway} = state) do
    terminal? = state.style == :table

    view =
      View.collect(gateway,
        started: state.started,
        nats_login: if(terminal?, do: Aerie.Fleet.Bridge.login_url(gateway)),
        published: published(gateway),
        warnings: if(state.config, do: state.config.warnings, else: []),
        http: state.http,
        console: if(terminal? and state.http != nil, do: Launch.url(gateway, state.http)),
        notes: state.notes
      )

    commands = Map.new(view.links, &{&1.id, MavRouter.Router.command_permission(gateway, &1.id)})
    %{view | interfaces: Access.list(view.links, commands, view.clients, bound(state), listed(gateway))}
  end

  # The configuration with the ports that the servers really got.
  defp bound(%{config: nil}), do: nil

  defp bound(%{config: config, gateway: gateway}) do
    for {name, server} <- [http: Aerie.Api.Endpoint, websocket: Aerie.Api.WebSocket], reduce: config do
      config -> Map.update!(config, name, &bound(&1, server, gateway))
    end
  end

  defp bound(%{enabled: true, port: 0} = settings, server, gateway) do
    %{settings | port: server.port(gateway)}
  rescue
    # It does not listen at this moment.
    ArgumentError -> settings
  end

  defp bound(settings, _server, _gateway), do: settings

  defp published(gateway) do
    for %{name: "gateway_nats_messages_published_total", samples: samples} <-
          Aerie.Fleet.Bridge.metrics(gateway),
        {_labels, n} <- samples,
        reduce: 0,
        do: (sum -> sum + n)
  end

  defp first_draw(%{drawn: 0}), do: "\e[2J"
  defp first_draw(_state), do: ""

  defp write_lines(_state, []), do: :ok

  defp write_lines(state, lines) do
    now = System.os_time(:microsecond)

    IO.write(
      state.device,
      for({message, pairs} <- lines, do: Formatter.line(Log.format(), now, :info, message, pairs))
    )
  end

  defp clock(us) do
    us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()
  end

  defp schedule(state, period) do
    Process.send_after(self(), :show, period)
    state
  end
end

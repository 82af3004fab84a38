defmodule Aerie.Console.Pages.Inspector.Page do
  @moduledoc """
  All messages on the links, live: their rates, and the fields and bytes of the chosen one. Messages can be sent like those of a
  client (`Aerie.Fleet.Inspector.send/4`).
  """
  use Aerie.Console,
      {:page,
       events: [viewer: ~w(filter sort choose close freeze), operator: ~w(compose composed send discard)],
       costly: ~w(filter sort)}

  import Aerie.Console.Pages.Inspector.Parts

  alias Aerie.Base.Store
  alias Aerie.Fleet.Inspector
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Pages.Inspector.Rows
  alias Aerie.Console.UI.Age

  @sorts %{"name" => :name, "hz" => :hz, "vehicle" => :vehicle, "link" => :link}
  @max_log 20

  @impl Phoenix.LiveView
  def mount(_params, _session, %{assigns: %{gateway: gateway, user: user}} = socket) do
    watch = if connected?(socket), do: Inspector.watch(gateway)

    {:ok,
     socket
     |> assign(
       page_title: "Inspector",
       watch: watch,
       frozen?: false,
       filter: Rows.received(),
       sort: {:name, :asc},
       chosen: nil,
       detail: nil,
       may_send?: Roles.at_least?(user.role, :operator),
       compose: nil,
       sending: nil,
       log: []
     )
     |> subscribe([:links])
     |> load()}
  end

  @impl Phoenix.LiveView
  def handle_event("filter", params, socket),
    do: {:noreply, socket |> assign(:filter, Rows.filter(params)) |> assign_rows()}

  def handle_event("sort", %{"by" => by}, socket) when is_map_key(@sorts, by) do
    column = @sorts[by]
    sort = if socket.assigns.sort == {column, :asc}, do: {column, :desc}, else: {column, :asc}
    {:noreply, socket |> assign(:sort, sort) |> assign_rows()}
  end

  # The id is compared with those that are shown, and not parsed.
  def handle_event("choose", %{"row" => id}, socket) do
    key = Enum.find_value(socket.assigns.shown, &(&1.id == id && &1.key))
    {:noreply, socket |> assign(:chosen, key) |> detail()}
  end

  def handle_event("close", _value, socket), do: {:noreply, assign(socket, chosen: nil, detail: nil)}

  def handle_event("freeze", _value, socket),
    do: {:noreply, socket |> assign(:frozen?, not socket.assigns.frozen?) |> load()}

  def handle_event("compose", %{"message" => name}, socket) when is_binary(name),
    do: {:noreply, assign(socket, :compose, compose(name, %{}, %{}))}

  def handle_event("compose", _value, socket),
    do: {:noreply, assign(socket, :compose, compose("COMMAND_LONG", %{}, %{}))}

  def handle_event("composed", %{"message" => name} = params, %{assigns: %{compose: %{name: name}}} = socket) do
    fields = fields(params)

    errors =
      case Inspector.compose(name, fields) do
        {:ok, _message} -> %{}
        {:error, errors} -> errors
      end

    {:noreply, assign(socket, :compose, compose(name, fields, errors))}
  end

  # Another message was chosen; the input belongs to the former one.
  def handle_event("composed", %{"message" => name}, socket) when is_binary(name),
    do: {:noreply, assign(socket, :compose, compose(name, %{}, %{}))}

  def handle_event("send", _params, %{assigns: %{sending: task}} = socket) when task != nil,
    do: {:noreply, socket}

  def handle_event(
        "send",
        %{"message" => name} = params,
        %{assigns: %{gateway: gateway, user: user}} = socket
      ) do
    fields = fields(params)

    case Inspector.compose(name, fields) do
      {:ok, message} ->
        source = %{user | name: "console:" <> user.name}

        task =
          Task.async(fn -> Inspector.send(gateway, source, message, network(params["network"], socket)) end)

        {:noreply, assign(socket, compose: compose(name, fields, %{}), sending: {task.ref, name})}

      {:error, errors} ->
        {:noreply, assign(socket, :compose, compose(name, fields, errors))}
    end
  end

  def handle_event("discard", _value, socket), do: {:noreply, assign(socket, :compose, nil)}
  def handle_event(_event, _value, socket), do: {:noreply, socket}

  defp fields(params) do
    for {name, text} <- params["field"] || %{},
        is_binary(name) and is_binary(text),
        into: %{},
        do: {name, text}
  end

  defp network(name, %{assigns: %{networks: networks}}) do
    if name in Map.values(networks), do: name, else: :all
  end

  defp compose(name, texts, errors),
    do: %{name: name, fields: Inspector.message_fields(name), texts: texts, errors: errors}

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, socket |> watch() |> load()}

  def handle_info({ref, result}, %{assigns: %{sending: {ref, name}}} = socket) do
    Process.demonitor(ref, [:flush])

    entry =
      Map.merge(outcome(result), %{
        name: name,
        at: System.os_time(:microsecond),
        n: System.unique_integer([:positive])
      })

    {:noreply, assign(socket, sending: nil, log: Enum.take([entry | socket.assigns.log], @max_log))}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, %{assigns: %{sending: {ref, name}}} = socket) do
    {:noreply,
     socket |> assign(:sending, nil) |> put_flash(:error, "#{name} was not sent: the sender crashed")}
  end

  def handle_info(_stray, socket), do: {:noreply, socket}

  defp outcome({:error, text}), do: %{outcome: :failed, text: text, answers: []}

  defp outcome({:ok, %{outcome: outcome, answers: answers}}) do
    %{
      outcome: outcome,
      text: nil,
      answers:
        for(frame <- answers, %{name: name, fields: fields} = Inspector.show(frame), do: {name, fields || []})
    }
  end

  # The inspector or the recorder may have restarted.
  defp watch(%{assigns: %{gateway: gateway}} = socket), do: assign(socket, :watch, Inspector.watch(gateway))

  defp load(%{assigns: %{frozen?: true}} = socket), do: socket

  defp load(%{assigns: %{gateway: gateway}} = socket) do
    networks = for link <- Store.links(gateway), into: %{}, do: {link.id, link.network}
    vehicles = for %{key: key, id: id} <- Store.vehicles(gateway), into: %{}, do: {key, id}
    rows = Inspector.rows(gateway)

    socket
    |> assign(
      rows: rows,
      networks: networks,
      vehicles: vehicles,
      skipped: Inspector.skipped(gateway),
      choices: Rows.choices(rows, networks, vehicles),
      now: System.os_time(:microsecond)
    )
    |> assign_rows()
    |> detail()
  end

  defp assign_rows(%{assigns: assigns} = socket) do
    {shown, more} =
      Rows.rows(assigns.rows, assigns.filter, assigns.networks, assigns.vehicles, assigns.sort, assigns.now)

    assign(socket, shown: shown, more: more)
  end

  defp detail(%{assigns: %{chosen: nil}} = socket), do: assign(socket, :detail, nil)
  defp detail(%{assigns: %{frozen?: true, detail: %{key: key}, chosen: key}} = socket), do: socket

  defp detail(%{assigns: %{chosen: key, gateway: gateway, detail: last}} = socket) do
    detail =
      case Inspector.last(gateway, key) do
        # The message has been silent for a minute; its last values stay, marked as gone.
        nil -> if match?(%{key: ^key}, last), do: %{last | gone?: true}, else: nil
        frame -> frame |> Inspector.show() |> Map.merge(%{key: key, frame: frame, gone?: false})
      end

    assign(socket, :detail, detail)
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Inspector</h1>
      <div class="row">
        <span :if={@skipped > 0} class="muted" id="inspector-skipped">{@skipped} frames skipped</span>
        <.button phx-click="freeze" icon={if(@frozen?, do: "play", else: "pause")} aria-pressed={to_string(@frozen?)}>
          {if @frozen?, do: "Resume", else: "Freeze"}
        </.button>
        <.button :if={@may_send?} kind="primary" phx-click="compose" icon="upload">Send a message</.button>
      </div>
    </div>
    <.error :if={@watch == {:error, :no_recorder}} title="No messages">
      The inspector needs the recorder, which is not running.
    </.error>
    <.error :if={@watch == {:error, :not_running}} title="The inspector is not running">It restarts by itself.</.error>
    <.stale :if={@frozen?}>Frozen: values do not change until you resume.</.stale>
    <.filters filter={@filter} choices={@choices} />
    <.loading :if={@watch == nil} />
    <.empty :if={@watch == :ok && @rows == []} icon="inspector" title="No messages yet">
      Messages appear here as soon as they are received.
    </.empty>
    <.empty :if={@rows != [] && @shown == []} icon="filter" title="No message matches the filter" />
    <div class={["inspector", @detail && "split"]}>
      <div :if={@shown != []}>
        <.data_table id="messages" label="Messages" rows={@shown} row_id={& &1.id} row_class={&(&1.key == @chosen && "selected")} sort={{sort_name(@sort), elem(@sort, 1)}}>
          <:col :let={row} label="Message" sort="name" class="grow">
            <button type="button" class="link-button mono" phx-click="choose" phx-value-row={row.id} aria-pressed={to_string(row.key == @chosen)}>{row.name}</button>
          </:col>
          <:col :let={row} label="From" sort="vehicle">{row.vehicle} <span class="muted">: {elem(row.key, 3)}</span></:col>
          <:col :let={row} label="Link" sort="link"><.direction direction={elem(row.key, 1)} /> {elem(row.key, 0)}</:col>
          <:col :let={row} label="Rate" sort="hz" number>{hz(row.hz)}</:col>
          <:col :let={row} label="Count" number>{row.count}</:col>
          <:col :let={row} label="Age" number>{Age.text(row.age_us)}</:col>
        </.data_table>
        <p :if={@more > 0} class="muted">{@more} more: filter by name, vehicle or link.</p>
        <p class="muted">Counts start when the first inspector page is opened.</p>
      </div>
      <.message :if={@detail} detail={@detail} />
    </div>
    <.sent :if={@log != []} log={@log} now={@now} />
    <.compose_dialog :if={@compose && @may_send?} compose={@compose} networks={@networks |> Map.values() |> Enum.uniq() |> Enum.sort()} sending?={@sending != nil} />
    """
  end

  defp sort_name({column, _order}), do: Enum.find_value(@sorts, fn {name, own} -> own == column && name end)
end

defmodule Aerie.Console.Pages.Shadow.Page do
  @moduledoc """
  The shadow of a vehicle: what is desired of it, what it is, and how the two stand (docs/shadow.md). What is changed is meant for the version
  that the page shows, so that nobody overwrites what he has not seen.
  """
  use Aerie.Console, {:page, []}

  import Aerie.Console.Pages.Shadow.Parts

  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias Aerie.Console.Clock
  alias Aerie.Console.Pages.Shadow.{Input, Rows}
  alias Aerie.Console.Pages.Vehicle.Sections

  @ask_us 5_000_000

  @impl Phoenix.LiveView
  def mount(%{"id" => id}, _session, socket) do
    {:ok,
     socket
     |> assign(id: id, page_title: "Shadow of #{id}", names: Input.fields(socket.assigns.user))
     |> assign(form: Input.form(""), error: nil, asking: false, problem: nil, answer: nil, asked_at: 0)
     |> subscribe([{:vehicle, id}])
     |> load()}
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  def handle_info({:shadow, {:ok, answer}}, socket),
    do: {:noreply, socket |> assign(:answer, answer) |> load()}

  def handle_info({:shadow, {:error, refusal}}, socket),
    do: {:noreply, assign(socket, :problem, Shadow.text(refusal))}

  def handle_info(_other, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_event("form", form, socket),
    do: {:noreply, assign(socket, form: texts(socket, form), error: nil)}

  def handle_event("edit", %{"path" => path}, %{assigns: %{rows: rows}} = socket) do
    case Enum.find(rows, &(&1.path == path)) do
      %{able: true, desired: desired} ->
        {:noreply, assign(socket, form: Input.form(path, desired), error: nil)}

      _gone ->
        {:noreply, socket}
    end
  end

  # Based on the version that the page showed, which may not be the latest.
  def handle_event("desire", %{"fields" => %{"version" => version} = form}, socket) do
    version = Input.version(version)
    form = texts(socket, form)

    case Input.request(form, version) do
      {:ok, request} ->
        socket |> assign(:form, form) |> change(&Shadow.update(&1, &2, request, &3, "console"))

      {:error, text} ->
        {:noreply, assign(socket, form: form, error: text)}
    end
  end

  def handle_event("remove", %{"path" => path, "version" => version}, %{assigns: %{shadow: shadow}} = socket)
      when is_binary(path) do
    if is_map_key(shadow["set"], path),
      do: change(socket, &Shadow.update(&1, &2, Input.removal(path, version), &3, "console")),
      else: {:noreply, socket}
  end

  def handle_event("ask", _value, socket), do: {:noreply, assign(socket, :asking, true)}
  def handle_event("cancel", _value, socket), do: {:noreply, assign(socket, :asking, false)}

  def handle_event("remove_all", %{"version" => version}, socket) do
    request = %{"version" => version}
    socket |> assign(:asking, false) |> change(&Shadow.delete(&1, &2, request, &3, "console"))
  end

  def handle_event(_other, _value, socket), do: {:noreply, socket}

  defp texts(%{assigns: %{form: form}}, fields),
    do: for({name, before} <- form, into: %{}, do: {name, text(fields[name], before)})

  defp text(text, _before) when is_binary(text), do: String.slice(text, 0, 500)
  defp text(_absent, before), do: before

  defp change(%{assigns: %{gateway: gateway, id: id, user: user}} = socket, change) do
    case change.(gateway, id, user) do
      {:ok, _desired} ->
        {:noreply, socket |> assign(form: Input.form(""), error: nil, asked_at: 0) |> load()}

      {:error, refusal} ->
        {:noreply, socket |> assign(error: Shadow.text(refusal), asked_at: 0) |> load()}
    end
  end

  # Data of this gateway is free. For a vehicle that another one hears, a task asks NATS now and then.
  defp load(%{assigns: %{gateway: gateway, id: id, user: user}} = socket) do
    socket = assign(socket, now: System.os_time(:microsecond), heard: Fleet.vehicle(gateway, id) != nil)

    case Shadow.status(gateway, id) do
      {:ok, shadow} -> assign_shadow(assign(socket, :problem, shadow["problem"]), shadow, user)
      :elsewhere -> socket |> ask() |> assign_shadow(socket.assigns.answer || Shadow.nothing(id), user)
    end
  end

  defp assign_shadow(socket, shadow, user), do: assign(socket, shadow: shadow, rows: Rows.rows(shadow, user))

  defp ask(%{assigns: %{now: now, asked_at: asked, gateway: gateway, id: id}} = socket)
       when now - asked > @ask_us do
    page = self()
    _ = if connected?(socket), do: Task.start(fn -> send(page, {:shadow, Shadow.get(gateway, id)}) end)

    assign(socket, :asked_at, now)
  end

  defp ask(socket), do: socket

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Shadow of {@id}</h1>
      <div class="row">
        <.link :if={@heard} navigate={Sections.path(@id, "fly")}>To the vehicle</.link>
        <.button :if={@names != [] and @rows != []} small icon="trash" phx-click="ask">Remove all</.button>
      </div>
    </div>
    <div class="stack">
      <p :if={@problem} class="notice warn" role="alert"><.icon name="alert" /> <span>{@problem}</span></p>
      <p :if={holds(@shadow) != []} class="notice info" role="status">
        <.icon name="lock" /> <span>Held: {Enum.map_join(holds(@shadow), "; ", &hold/1)}</span>
      </p>
      <.empty :if={@rows == []} icon="check" title="No desired state">The gateway leaves the vehicle as it is.</.empty>
      <.fields :if={@rows != []} rows={@rows} version={@shadow["version"]} />
      <p :if={@rows != []} class="muted">Version {@shadow["version"]}, changed {Clock.full(@shadow["updated_at"])}{by(@shadow)}.</p>
      <.desire :if={@names != []} form={@form} names={@names} version={@shadow["version"]} error={@error} />
      <.history history={@shadow["history"]} />
    </div>
    <.dialog :if={@asking} id="remove-all" title={"Remove the desired state of #{@id}?"} cancel="cancel" kind="danger">
      <p>This removes all {length(@rows)} fields. The vehicle stays as it is.</p>
      <:action><.button phx-click="cancel">Keep</.button></:action>
      <:action><.button kind="danger" phx-click={JS.push("remove_all", value: %{version: @shadow["version"]})}>Remove</.button></:action>
    </.dialog>
    """
  end

  defp holds(%{"reported" => %{"holds" => holds}}) when is_list(holds), do: holds
  defp holds(_shadow), do: []

  defp hold(hold),
    do:
      Enum.join(
        [hold["by"], hold["why"] | List.wrap(hold["until"] && "until #{Clock.full(hold["until"])}")],
        ", "
      )

  defp by(%{"reported" => %{"gateway" => name}}) when is_binary(name), do: "; the gateway #{name} acts on it"
  defp by(_shadow), do: ""
end

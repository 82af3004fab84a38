defmodule Aerie.Console.Pages.Links.Page do
  @moduledoc "The page of links, networks, clients, routes and rules. Admins add, remove and restart links."
  use Aerie.Console,
      {:page,
       events: [admin: ~w(ask cancel)],
       changes: [
         add_link: ~w(add),
         remove_link: ~w(remove),
         restart_link: ~w(restart),
         remove_client: ~w(remove-client),
         reset_rules: ~w(reset)
       ]}

  import Aerie.Console.Pages.Links.Parts

  alias Aerie.Base.Store
  alias Aerie.Base.Net.Address
  alias MavRouter.{Client, Link, Router}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Changes
  alias Aerie.Console.Pages.Links.View

  @parts [{"links", "Links"}, {"clients", "Clients"}, {"routes", "Routes"}, {"rules", "Changed rules"}]
  @sample_us 1_000_000

  @impl Phoenix.LiveView
  def mount(_params, _session, %{assigns: %{user: user}} = socket) do
    {:ok,
     socket
     |> assign(
       page_title: "Links",
       part: "links",
       link: nil,
       samples: [],
       sampled_at: nil,
       admin?: Roles.at_least?(user.role, :admin),
       asking: nil,
       form: %{},
       error: nil
     )
     |> subscribe([:links])}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    part = if List.keymember?(@parts, params["part"], 0), do: params["part"], else: "links"
    id = if is_binary(params["link"]), do: params["link"]
    {:noreply, socket |> assign(part: part, chosen: id, samples: [], sampled_at: nil) |> load()}
  end

  @impl Phoenix.LiveView
  def handle_event("ask", %{"what" => "add"}, socket),
    do: {:noreply, assign(socket, asking: :add, form: %{}, error: nil)}

  def handle_event("ask", %{"what" => what, "id" => id}, socket)
      when what in ~w(remove restart remove-client) and is_binary(id),
      do: {:noreply, assign(socket, asking: {what, id}, error: nil)}

  def handle_event("cancel", _value, socket), do: {:noreply, assign(socket, asking: nil, error: nil)}

  # The confirmation applies to what the dialog named (`id`), not to a later request.

  def handle_event("add", %{"url" => url} = form, %{assigns: %{gateway: gateway}} = socket)
      when is_binary(url) do
    options =
      for {key, name} <- [id: "id", network: "network"],
          is_binary(form[name]) and form[name] != "",
          do: {key, String.trim(form[name])}

    case add(gateway, String.trim(url), options) do
      {:ok, id} ->
        note(socket, "add", id, url)

        {:noreply,
         socket
         |> assign(asking: nil)
         |> put_flash(:info, "Link #{id} added. It is temporary: gone when the gateway stops.")
         |> load()}

      {:error, text} ->
        {:noreply, assign(socket, form: Map.take(form, ~w(url id network)), error: text)}
    end
  end

  def handle_event("remove", %{"id" => id}, %{assigns: %{asking: {"remove", id}, gateway: gateway}} = socket) do
    :ok = Link.stop(gateway, id)
    note(socket, "remove", id, nil)

    {:noreply,
     socket |> assign(:asking, nil) |> put_flash(:info, "Link #{id} removed.") |> push_patch(to: "/links")}
  end

  def handle_event(
        "remove-client",
        %{"id" => id},
        %{assigns: %{asking: {"remove-client", id}, gateway: gateway}} = socket
      ),
      do: {:noreply, answer(socket, Client.remove(gateway, id), "remove-client", id, "Client #{id} removed.")}

  def handle_event(
        "restart",
        %{"id" => id},
        %{assigns: %{asking: {"restart", id}, gateway: gateway}} = socket
      ),
      do: {:noreply, answer(socket, Link.restart(gateway, id), "restart", id, "Link #{id} restarted.")}

  def handle_event("reset", %{"id" => id}, %{assigns: %{gateway: gateway}} = socket) when is_binary(id),
    do:
      {:noreply,
       answer(
         socket,
         Router.reset(gateway, id),
         "reset-rules",
         id,
         "The rules of #{id} are as configured again."
       )}

  def handle_event(_event, _value, socket), do: {:noreply, socket}

  # Recordings are played from their own page: here the address could be any file of this machine.
  defp add(_gateway, "replay:" <> _file, _options),
    do: {:error, "play recordings from the page Recordings"}

  defp add(gateway, url, options) do
    with {:error, error} <- Link.start(gateway, url, options), do: {:error, Exception.message(error)}
  end

  defp answer(socket, result, what, id, text) do
    case result do
      :ok ->
        note(socket, what, id, nil)
        socket |> assign(:asking, nil) |> put_flash(:info, text) |> load()

      {:error, error} ->
        socket |> assign(:asking, nil) |> put_flash(:error, Exception.message(error)) |> load()
    end
  end

  defp note(%{assigns: %{gateway: gateway} = assigns}, what, id, url) do
    said = %{"action" => what, "link" => id, "url" => url && Address.shown(url)}
    Changes.note(gateway, Changes.user(assigns), "link", said)
  end

  @impl Phoenix.LiveView
  def handle_info(:refresh, socket), do: {:noreply, load(socket)}

  defp load(%{assigns: %{gateway: gateway, chosen: chosen}} = socket) do
    now = System.os_time(:microsecond)
    clients = MapSet.new(Client.endpoints(gateway), & &1.id)
    links = for link <- Store.links(gateway), link.id not in clients, do: link

    {routes, more_routes} =
      if socket.assigns.part == "routes", do: View.routes(Router.routes(gateway)), else: {[], 0}

    socket
    |> assign(
      now: now,
      rows: Enum.map(links, &View.link(&1, now)),
      networks: View.networks(links, Store.vehicles(gateway)),
      endpoints:
        gateway
        |> Router.endpoints()
        |> Enum.with_index()
        |> Enum.map(fn {endpoint, n} -> View.endpoint(endpoint, n) end),
      client_endpoints: Client.endpoints(gateway),
      routes: routes,
      more_routes: more_routes,
      rules:
        for(
          {owner, changes} <- Enum.sort(Router.changes(gateway)),
          {key, change} <- Enum.sort(changes),
          do: %{owner: owner, key: key, change: change}
        ),
      link: chosen && Link.get(gateway, chosen)
    )
    |> sample(now)
  end

  defp sample(%{assigns: %{link: nil}} = socket, _now), do: socket

  defp sample(%{assigns: %{sampled_at: at}} = socket, now) when at != nil and now - at < @sample_us,
    do: socket

  defp sample(socket, now),
    do: assign(socket, samples: View.sampled(socket.assigns.samples, socket.assigns.link), sampled_at: now)

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <div class="spread page-title">
      <h1>Links</h1>
      <.button :if={@admin?} kind="primary" icon="plus" phx-click="ask" phx-value-what="add">Add a link</.button>
    </div>
    <.tabs label="Parts of the links">
      <:tab :for={{id, label} <- parts()} patch={"/links?part=#{id}"} current={@part == id}>{label}</:tab>
    </.tabs>
    <.error :if={@chosen && @link == nil} title={"No link #{@chosen}"}>It was removed or renamed.</.error>
    <.link_detail :if={@link} link={@link} samples={@samples} admin?={@admin?} now={@now} endpoints={Enum.filter(@endpoints, &(&1.owner == @link.id))} />
    <div :if={@part == "links" && @link == nil}>
      <.empty :if={@rows == []} icon="link" title="No links">Configure links under <code>links</code>; an admin can add one here.</.empty>
      <.link_table :if={@rows != []} rows={@rows} />
      <.networks :if={@networks != []} networks={@networks} />
    </div>
    <div :if={@part == "clients"}>
      <.client_table endpoints={Enum.filter(@endpoints, &(&1.side == :client))} admin?={@admin?} />
      <.client_endpoints rows={@client_endpoints} admin?={@admin?} />
    </div>
    <.route_table :if={@part == "routes"} routes={@routes} more={@more_routes} />
    <.rule_table :if={@part == "rules"} rules={@rules} admin?={@admin?} />
    <.ask :if={@asking && @admin?} asking={@asking} form={@form} error={@error} networks={@networks} />
    """
  end

  defp parts, do: @parts
end

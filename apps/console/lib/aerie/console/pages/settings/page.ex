defmodule Aerie.Console.Pages.Settings.Page do
  @moduledoc "The page of the settings: one's own password; for admins users, API keys, the map, the configuration."
  use Aerie.Console,
      {:page,
       events: [
         viewer: ~w(own-password),
         admin: ~w(ask cancel key-copied configuration)
       ],
       changes: [
         change_users: ~w(add change-role change-permissions change-password remove),
         make_key: ~w(add-key),
         revoke_key: ~w(revoke-key),
         change_map: ~w(clear-map forget-area)
       ]}

  import Aerie.Console.Pages.Settings.Configuration, only: [configuration: 1]
  import Aerie.Console.Pages.Settings.BaseMap, only: [base_map: 1]
  import Aerie.Console.Pages.Settings.ProgramKeys

  alias Aerie.Access.KeyRing
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.Changes
  alias Aerie.Access.Users
  alias Aerie.Access.Users.Password
  alias Aerie.Console.Map.Tiles
  alias Aerie.Console.Pages.Settings.Configuration

  @needed %{
    "add" => ~w(name role password),
    "change-password" => ~w(name password),
    "add-key" => ~w(name role expires)
  }

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    %{user: user, gateway: gateway} = socket.assigns

    socket =
      assign(socket,
        page_title: "Settings",
        admin?: Roles.at_least?(user.role, :admin),
        own?: Users.find(gateway, user.name) != nil,
        asking: nil,
        errors: %{},
        made: nil,
        part: "access",
        sections: [],
        layers: [],
        areas: [],
        filter: Configuration.filter(%{})
      )

    {:ok, load(socket)}
  end

  @impl Phoenix.LiveView
  def handle_params(%{"part" => "configuration"}, _uri, %{assigns: %{admin?: true}} = socket),
    do:
      {:noreply,
       assign(socket, part: "configuration", sections: Configuration.sections(socket.assigns.gateway))}

  def handle_params(%{"part" => "map"}, _uri, %{assigns: %{admin?: true}} = socket),
    do: {:noreply, socket |> subscribe([]) |> assign(:part, "map") |> layers()}

  def handle_params(_params, _uri, socket), do: {:noreply, assign(socket, part: "access")}

  @impl Phoenix.LiveView
  def handle_info(:refresh, %{assigns: %{part: "map"}} = socket), do: {:noreply, layers(socket)}
  def handle_info(_message, socket), do: {:noreply, socket}

  defp layers(%{assigns: %{gateway: gateway}} = socket),
    do: assign(socket, layers: Tiles.overview(gateway), areas: Tiles.areas(gateway))

  defp load(%{assigns: %{gateway: gateway}} = socket),
    do: assign(socket, users: Users.list(gateway), keys: KeyRing.list(gateway))

  @impl Phoenix.LiveView
  def handle_event("own-password", %{"old" => old, "new" => new} = form, socket) do
    %{gateway: gateway, user: user} = socket.assigns

    case Users.check(gateway, user.name, old, {:name, user.name}) do
      {:ok, _user} ->
        change(
          socket,
          :own,
          Users.same(new, form["again"]),
          &Users.set_password(gateway, user.name, &1, Changes.user(socket.assigns))
        )

      :error ->
        {:noreply, assign(socket, :errors, %{own: "the old password is wrong"})}

      {:busy, seconds} ->
        {:noreply, assign(socket, :errors, %{own: Users.busy(seconds)})}
    end
  end

  def handle_event("ask", %{"what" => what, "name" => name}, socket)
      when what in ~w(remove password permissions revoke clear),
      do: {:noreply, assign(socket, asking: {what, name}, errors: %{})}

  def handle_event("cancel", _value, socket), do: {:noreply, assign(socket, asking: nil, errors: %{})}

  def handle_event("add", %{"name" => name, "role" => role, "password" => password}, socket),
    do:
      change(
        socket,
        :add,
        {:ok, password},
        &Users.add(socket.assigns.gateway, name, role, &1, Changes.user(socket.assigns))
      )

  def handle_event("change-role", %{"name" => name, "role" => role}, socket),
    do:
      change(
        socket,
        :role,
        {:ok, role},
        &Users.set_role(socket.assigns.gateway, name, &1, Changes.user(socket.assigns))
      )

  def handle_event("change-permissions", %{"name" => name} = form, socket) do
    given = for {"permission-" <> permission, "true"} <- form, do: permission

    change(
      socket,
      :permissions,
      {:ok, given},
      &Users.set_permissions(socket.assigns.gateway, name, &1, Changes.user(socket.assigns))
    )
  end

  def handle_event("change-password", %{"name" => name, "password" => password}, socket),
    do:
      change(
        socket,
        :password,
        {:ok, password},
        &Users.set_password(socket.assigns.gateway, name, &1, Changes.user(socket.assigns))
      )

  def handle_event("remove", %{"name" => name}, socket),
    do:
      change(
        socket,
        :remove,
        {:ok, name},
        &Users.remove(socket.assigns.gateway, &1, Changes.user(socket.assigns))
      )

  def handle_event("add-key", %{"name" => name, "role" => role, "expires" => expires}, socket) do
    case KeyRing.make(socket.assigns.gateway, name, role, expires, Changes.user(socket.assigns)) do
      {:ok, text} -> {:noreply, socket |> assign(made: {name, text}, errors: %{}) |> load()}
      {:error, words} -> {:noreply, assign(socket, :errors, %{key: words})}
    end
  end

  def handle_event("key-copied", _value, socket), do: {:noreply, assign(socket, :made, nil)}

  def handle_event("revoke-key", %{"name" => name}, socket),
    do:
      change(
        socket,
        :revoke,
        {:ok, name},
        &KeyRing.revoke(socket.assigns.gateway, &1, Changes.user(socket.assigns))
      )

  def handle_event("clear-map", %{"name" => name}, socket) do
    {:noreply, socket} =
      change(
        socket,
        :clear,
        {:ok, name},
        &Tiles.clear(socket.assigns.gateway, &1, Changes.user(socket.assigns))
      )

    {:noreply, layers(socket)}
  end

  def handle_event("forget-area", %{"at" => at}, %{assigns: %{areas: areas}} = socket) do
    by = Changes.user(socket.assigns)
    found = for %{at: known} <- areas, Integer.to_string(known) == at, do: known

    case Enum.find_value(found, :ok, &Tiles.forget(socket.assigns.gateway, &1, by)) do
      :ok -> {:noreply, layers(socket)}
      {:error, words} -> {:noreply, put_flash(socket, :error, words)}
    end
  end

  def handle_event("configuration", form, socket),
    do: {:noreply, assign(socket, :filter, Configuration.filter(form))}

  def handle_event(event, value, socket) do
    missing = Enum.reject(Map.get(@needed, event, []), &is_map_key(value, &1))
    {:noreply, put_flash(socket, :error, "Fill in #{Enum.join(missing, " and ")}.")}
  end

  defp change(socket, what, value, fun) do
    case with({:ok, value} <- value, do: fun.(value)) do
      :ok ->
        {:noreply, socket |> assign(asking: nil, errors: %{}) |> put_flash(:info, done(what)) |> load()}

      {:error, words} ->
        {:noreply, assign(socket, :errors, %{what => words})}
    end
  end

  defp done(:add), do: "User added. They can sign in now."
  defp done(:remove), do: "User removed and signed out."
  defp done(:clear), do: "What was kept of the layer is removed."
  defp done(:revoke), do: "Key revoked."
  defp done(:role), do: "Role changed."
  defp done(:permissions), do: "Permissions changed. The user's next session has them."
  defp done(_password), do: "Password changed. Sign in with the new one."

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <h1 class="page-title">Settings</h1>
    <.tabs :if={@admin?} label="Parts of the settings">
      <:tab patch="/settings" current={@part == "access"} icon="user">Access</:tab>
      <:tab patch="/settings?part=map" current={@part == "map"} icon="map">Map</:tab>
      <:tab patch="/settings?part=configuration" current={@part == "configuration"} icon="list">Configuration</:tab>
    </.tabs>
    <.configuration :if={@part == "configuration"} sections={@sections} filter={@filter} />
    <.base_map :if={@part == "map"} layers={@layers} areas={@areas} />
    <div :if={@part == "access"} class="stack settings">
      <section :if={@admin?} class="card" aria-labelledby="users-title">
        <h2 id="users-title">Users</h2>
        <p :if={@users == []} class="muted">
          No users yet: the console works only on the gateway's own machine.
        </p>
        <.data_table :if={@users != []} id="users" label="Users" rows={@users} row_id={&"user-#{&1.name}"}>
          <:col :let={user} label="Name"><strong>{user.name}</strong></:col>
          <:col :let={user} label="Role">
            <form id={"role-#{user.name}"} phx-change="change-role" phx-auto-recover="ignore">
              <input type="hidden" name="name" value={user.name} />
              <.field id={"role-of-#{user.name}"} name="role" type="select" label={"Role of #{user.name}"} label_hidden options={roles()} value={to_string(user.role)} />
            </form>
          </:col>
          <:col :let={user} label="Permissions beyond it">
            <span class="user-permissions">{Enum.join(user.permissions, ", ")}</span>
            <.button
              :if={Roles.beyond(user.role) != []}
              small
              phx-click="ask"
              phx-value-what="permissions"
              phx-value-name={user.name}
            >Permissions…</.button>
          </:col>
          <:col :let={user} label="">
            <div class="row">
              <.button small icon="lock" phx-click="ask" phx-value-what="password" phx-value-name={user.name}>Password</.button>
              <.button small icon="trash" phx-click="ask" phx-value-what="remove" phx-value-name={user.name}>Remove</.button>
            </div>
          </:col>
        </.data_table>
        <p :if={@errors[:role]} class="notice bad" role="alert">{@errors[:role]}</p>
        <h3>Add a user</h3>
        <form id="add-user" class="form-row" phx-submit="add" phx-auto-recover="ignore" autocomplete="off">
          <.field id="new-name" name="name" label="Name" maxlength="32" required />
          <.field id="new-role" name="role" type="select" label="Role" options={roles()} value="operator" />
          <.field id="new-password" name="password" type="password" label="Password" autocomplete="new-password" minlength={"#{Password.shortest()}"} required />
          <.button type="submit" kind="primary" icon="plus">Add</.button>
        </form>
        <p :if={@errors[:add]} class="notice bad" role="alert">{@errors[:add]}</p>
        <p class="hint">Viewers can only watch. Operators command vehicles. Admins also maintain vehicles and change the gateway and its users.</p>
      </section>

      <section class="card" aria-labelledby="own-title">
        <h2 id="own-title">Your password</h2>
        <p :if={!@own?} class="muted">You signed in with the start link; this account has no password.</p>
        <form :if={@own?} id="own-password" class="form-row" phx-submit="own-password" phx-auto-recover="ignore">
          <.field id="own-old" name="old" type="password" label="Old password" autocomplete="current-password" required />
          <.field id="own-new" name="new" type="password" label="New password" autocomplete="new-password" minlength={"#{Password.shortest()}"} required />
          <.field id="own-again" name="again" type="password" label="New password again" autocomplete="new-password" required />
          <.button type="submit">Change</.button>
        </form>
        <p :if={@errors[:own]} class="notice bad" role="alert">{@errors[:own]}</p>
      </section>

      <.program_keys :if={@admin?} keys={@keys} made={@made} error={@errors[:key]} />
    </div>

    <.dialog :if={match?({"remove", _}, @asking)} id="remove-user" title={"Remove #{elem(@asking, 1)}?"} cancel="cancel" kind="danger">
      <p>The user is signed out at once and cannot sign in again.</p>
      <p :if={@errors[:remove]} class="notice bad" role="alert">{@errors[:remove]}</p>
      <:action><.button phx-click="cancel">Keep</.button></:action>
      <:action><.button kind="danger" phx-click="remove" phx-value-name={elem(@asking, 1)}>Remove</.button></:action>
    </.dialog>
    <.dialog
      :if={match?({"clear", _}, @asking)}
      id="clear-map"
      title={"Empty what is kept of #{elem(@asking, 1)}?"}
      cancel="cancel"
      kind="danger"
    >
      <p>The map is fetched again where somebody looks. Without internet it stays empty.</p>
      <p :if={@errors[:clear]} class="notice bad" role="alert">{@errors[:clear]}</p>
      <:action><.button phx-click="cancel">Keep</.button></:action>
      <:action><.button kind="danger" phx-click="clear-map" phx-value-name={elem(@asking, 1)}>Empty</.button></:action>
    </.dialog>
    <.dialog :if={match?({"revoke", _}, @asking)} id="revoke-key" title={"Revoke the key #{elem(@asking, 1)}?"} cancel="cancel" kind="danger">
      <p>Programs that use it are refused at once, and their WebSockets are closed.</p>
      <p :if={@errors[:revoke]} class="notice bad" role="alert">{@errors[:revoke]}</p>
      <:action><.button phx-click="cancel">Keep</.button></:action>
      <:action><.button kind="danger" phx-click="revoke-key" phx-value-name={elem(@asking, 1)}>Revoke</.button></:action>
    </.dialog>
    <.dialog
      :if={match?({"permissions", _}, @asking)}
      id="set-permissions"
      title={"Permissions of #{elem(@asking, 1)}"}
      cancel="cancel"
    >
      <form id="change-permissions" class="stack" phx-submit="change-permissions" phx-auto-recover="ignore">
        <input type="hidden" name="name" value={elem(@asking, 1)} />
        <.field
          :for={{permission, given?} <- permissions(@users, elem(@asking, 1))}
          id={"permission-#{permission}"}
          name={"permission-#{permission}"}
          type="checkbox"
          label={permission}
          value={given?}
          hint={Roles.guards(permission)}
        />
        <p class="hint">What each is needed for: docs/policy.md, Roles. The user's sessions will end.</p>
        <p :if={@errors[:permissions]} class="notice bad" role="alert">{@errors[:permissions]}</p>
        <.button type="submit" kind="primary">Change</.button>
      </form>
    </.dialog>
    <.dialog :if={match?({"password", _}, @asking)} id="set-password" title={"New password of #{elem(@asking, 1)}"} cancel="cancel">
      <form id="change-password" class="stack" phx-submit="change-password" phx-auto-recover="ignore">
        <input type="hidden" name="name" value={elem(@asking, 1)} />
        <.field id="set-password-field" name="password" type="password" label="Password" autocomplete="new-password" minlength={"#{Password.shortest()}"} required autofocus hint="The user's sessions will end." />
        <p :if={@errors[:password]} class="notice bad" role="alert">{@errors[:password]}</p>
        <.button type="submit" kind="primary">Change</.button>
      </form>
    </.dialog>
    """
  end

  # Somebody else may have removed the user meanwhile.
  defp permissions(users, name) do
    for %{name: ^name} = user <- users,
        permission <- Roles.beyond(user.role),
        do: {permission, permission in user.permissions}
  end

  defp roles, do: for(role <- Roles.all(), do: to_string(role))
end

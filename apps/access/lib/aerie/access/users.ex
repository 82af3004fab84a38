defmodule Aerie.Access.Users do
  @moduledoc """
  The users who may sign in, each with a role, and permissions beyond it: in a table that all processes read, and in a
  file that only its owner can read.

  ```json
  {"users": [{"name": "ann", "role": "operator", "permissions": ["receiver"], "password": "pbkdf2-sha256$600000$…$…"}]}
  ```

  A change is on disk before it takes effect, and open pages of the user are notified (`{:notice, :console_users}` of `Aerie.Base.PubSub`). The file is
  read only at start. A damaged one is set aside (`Aerie.Base.Files.Damaged`), and then nobody can sign in by name until an admin adds users; one
  that others can read is refused, and the console does not start.
  """
  use GenServer

  alias Aerie.Base.Files.Damaged
  alias Aerie.Base.Names
  alias Aerie.Base.PubSub
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Command.Type
  alias Aerie.Access.Changes
  alias Aerie.Access.PrivateFile
  alias Aerie.Access.Users.Password
  alias Aerie.Access.WorkLimit

  @most 100
  @name ~r/\A[a-z0-9][a-z0-9._-]{0,31}\z/

  @type user :: %{
          name: String.t(),
          role: Roles.role(),
          permissions: [Type.permission()],
          password: Password.stored()
        }

  @doc "Options: `:gateway`, `:file`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_users))

  @doc "All users, by name."
  @spec list(Names.gateway()) :: [user()]
  def list(gateway),
    do: Names.read(gateway, :console_users, [], &for({_name, user} <- :ets.tab2list(&1), do: user))

  @doc "One user."
  @spec find(Names.gateway(), String.t()) :: user() | nil
  def find(gateway, name),
    do: Names.read(gateway, :console_users, nil, &:ets.lookup_element(&1, name, 2, nil))

  @doc """
  The user with this name and password. An unknown name takes as long to check. Passwords are hashed in the places of `Aerie.Access.WorkLimit`, in
  the name of `asker`.
  """
  @spec check(Names.gateway(), term(), term(), WorkLimit.asker()) ::
          {:ok, user()} | :error | WorkLimit.refusal()
  def check(gateway, name, password, asker) do
    user = if is_binary(name), do: find(gateway, name)

    case WorkLimit.run(gateway, :password, asker, fn -> Password.match?(password, user[:password]) end) do
      {:ok, true} -> {:ok, user}
      {:ok, false} -> :error
      busy -> busy
    end
  end

  @doc "Adds a user, in the name of `by`."
  @spec add(Names.gateway(), term(), term(), term(), Changes.by()) :: :ok | {:error, String.t()}
  def add(gateway, name, role, password, by) do
    with :ok <- name(name),
         {:ok, role} <- role(role),
         :ok <- Password.check(password),
         {:ok, stored} <- hash(gateway, password, by) do
      change(gateway, {:add, %{name: name, role: role, permissions: [], password: stored}}, by)
    end
  end

  defp hash(gateway, password, by) do
    with {:busy, seconds} <-
           WorkLimit.run(gateway, :users, {:name, Changes.name(by)}, fn -> Password.hash(password) end),
         do: {:error, busy(seconds)}
  end

  @doc "The text for a requester that has to retry later."
  @spec busy(seconds :: pos_integer()) :: String.t()
  def busy(seconds), do: "too many passwords at once: try again in #{seconds} s"

  @doc "Changes a user's role, in the name of `by`, which ends the user's sessions."
  @spec set_role(Names.gateway(), String.t(), term(), Changes.by()) :: :ok | {:error, String.t()}
  def set_role(gateway, name, role, by \\ "elixir") do
    with {:ok, role} <- role(role), do: change(gateway, {:update, name, %{role: role}}, by)
  end

  @doc """
  Gives a user exactly these permissions beyond the role, in the name of `by`, which ends the user's sessions: the next one
  has them. A change of the role keeps what the new role does not include; a viewer is left without any.
  """
  @spec set_permissions(Names.gateway(), String.t(), names :: term(), Changes.by()) ::
          :ok | {:error, String.t()}
  def set_permissions(gateway, name, names, by \\ "elixir"),
    do: change(gateway, {:update, name, %{permissions: names}}, by)

  @doc "Changes a user's password, in the name of `by`, which ends the user's sessions."
  @spec set_password(Names.gateway(), String.t(), term(), Changes.by()) :: :ok | {:error, String.t()}
  def set_password(gateway, name, password, by) do
    with :ok <- Password.check(password),
         {:ok, stored} <- hash(gateway, password, by),
         do: change(gateway, {:update, name, %{password: stored}}, by)
  end

  @doc "The new password if both inputs are equal."
  @spec same(term(), term()) :: {:ok, term()} | {:error, String.t()}
  def same(password, password), do: {:ok, password}
  def same(_password, _other), do: {:error, "the two new passwords differ"}

  @doc "Removes a user, in the name of `by`."
  @spec remove(Names.gateway(), String.t(), Changes.by()) :: :ok | {:error, String.t()}
  def remove(gateway, name, by \\ "elixir"), do: change(gateway, {:remove, name}, by)

  defp change(gateway, change, by) do
    GenServer.call(Names.via(gateway, :console_users), {change, by})
  catch
    :exit, _gone -> {:error, "the gateway takes no changes of users just now; try again"}
  end

  @doc "The users' file in the console's folder."
  @spec file(Path.t()) :: Path.t()
  def file(dir), do: Path.join(dir, "users.json")

  @doc "The users of a file; none if there is no file."
  @spec read(Path.t()) :: {:ok, [user()]} | {:error, String.t()}
  def read(path) do
    with {:ok, text} <- PrivateFile.read(path), {:ok, users} <- parse(path, text) do
      {:ok, users}
    else
      {:error, :enoent} -> {:ok, []}
      {:error, text} -> {:error, text}
    end
  end

  # No message quotes the text, because it contains password hashes.
  defp parse(path, text) do
    with {:ok, %{"users" => users}} when is_list(users) and length(users) <= @most <- JSON.decode(text),
         {:ok, users} <- users |> Enum.with_index() |> each([]) do
      if users |> Enum.uniq_by(& &1.name) |> length() == length(users),
        do: {:ok, users},
        else: {:error, "#{path}: two users have the same name"}
    else
      {:error, words} when is_binary(words) -> {:error, "#{path}: #{words}"}
      _other -> {:error, ~s(#{path}: expected JSON with {"users": […]}, #{@most} at most)}
    end
  end

  defp each([], users), do: {:ok, Enum.reverse(users)}

  defp each([{%{"name" => name, "role" => role, "password" => stored} = user, index} | rest], users) do
    with :ok <- name(name),
         {:ok, role} <- role(role),
         {:ok, given} <- Roles.given(role, Map.get(user, "permissions", [])),
         true <- Password.stored?(stored) do
      each(rest, [%{name: name, role: role, permissions: given, password: stored} | users])
    else
      {:error, words} -> {:error, "users[#{index}]: #{words}"}
      false -> {:error, "users[#{index}].password: expected pbkdf2-sha256$ITERATIONS$SALT$HASH"}
    end
  end

  defp each([{_other, index} | _rest], _users),
    do: {:error, "users[#{index}]: expected name, role and password"}

  @doc "Whether this may be the name of a user or of a key that is made in the console."
  @spec name(term()) :: :ok | {:error, String.t()}
  def name(name) when is_binary(name) do
    if name =~ @name,
      do: :ok,
      else: {:error, "a name has 1 to 32 characters out of a-z, 0-9, dot, underscore and hyphen"}
  end

  def name(_other), do: {:error, "the name is missing"}

  defp role(role) do
    with :error <- Roles.parse(to_string(role)),
         do: {:error, "expected the role #{Enum.join(Roles.all(), ", ")}"}
  end

  @impl GenServer
  def init(options) do
    Process.set_label(:console_users)

    words = "nobody can sign in by name until users are added again"

    case PrivateFile.open(options[:gateway], options[:file], &read/1, words, []) do
      {:ok, users} ->
        table = :ets.new(:console_users, [:ordered_set, :protected, read_concurrency: true])
        true = :ets.insert(table, Enum.map(users, &{&1.name, &1}))
        Names.put_value(options[:gateway], :console_users, table)
        {:ok, %{gateway: options[:gateway], file: options[:file], table: table}}

      {:error, text} ->
        {:stop, text}
    end
  end

  @doc "Whether there are users, or were before their file was damaged: then the console is open to nobody, rather than to all."
  @spec any?(Path.t()) :: boolean()
  def any?(dir) do
    path = file(dir)

    case read(path) do
      {:ok, []} -> Path.wildcard(path <> ".damaged-*") != []
      {:ok, _users} -> true
      {:error, _text} -> Damaged.damaged?(path)
    end
  end

  @impl GenServer
  def handle_call({change, by}, _from, %{table: table} = state) do
    users = Map.new(:ets.tab2list(table))

    with {:ok, name, changed} <- changed(users, change),
         :ok <- write(state.file, Map.values(changed)) do
      true = :ets.delete(table, name)
      true = :ets.insert(table, Map.to_list(Map.take(changed, [name])))
      PubSub.publish(state.gateway, {:notice, :console_users}, name)
      Changes.note(state.gateway, by, "user", said(change, users))
      {:reply, :ok, state}
    else
      {:error, words} -> {:reply, {:error, words}, state}
    end
  end

  # The password itself is nobody's business.
  defp said({:update, name, %{permissions: names}}, users) do
    before = users[name].permissions
    %{"action" => "permissions", "user" => name, "permissions" => names, "before" => before}
  end

  defp said({:add, user}, _users), do: %{"action" => "add", "user" => user.name, "role" => user.role}
  defp said({:remove, name}, users), do: %{"action" => "remove", "user" => name, "before" => users[name].role}

  defp said({:update, name, %{role: role}}, users),
    do: %{"action" => "role", "user" => name, "role" => role, "before" => users[name].role}

  defp said({:update, name, %{password: _hidden}}, _users), do: %{"action" => "password", "user" => name}

  defp changed(users, {:add, %{name: name} = user}) do
    cond do
      is_map_key(users, name) -> {:error, "there already is a user #{name}"}
      map_size(users) >= @most -> {:error, "there are #{@most} users already"}
      true -> {:ok, name, Map.put(users, name, user)}
    end
  end

  defp changed(users, {:update, name, fields}) when is_map_key(users, name) do
    with {:ok, fields} <- fields(users[name], fields),
         do: {:ok, name, Map.update!(users, name, &Map.merge(&1, fields))}
  end

  defp changed(users, {:remove, name}) when is_map_key(users, name), do: {:ok, name, Map.delete(users, name)}
  defp changed(_users, _change), do: {:error, "there is no such user"}

  defp fields(user, %{permissions: names}),
    do: with({:ok, given} <- Roles.given(user.role, names), do: {:ok, %{permissions: given}})

  defp fields(user, %{role: role}),
    do: {:ok, %{role: role, permissions: Enum.filter(Roles.beyond(role), &(&1 in user.permissions))}}

  defp fields(_user, password), do: {:ok, password}

  defp write(file, users) do
    text = JSON.encode_to_iodata!(%{users: Enum.sort_by(users, & &1.name)})
    PrivateFile.write(file, [text, ?\n])
  end

  # The state and messages contain password hashes.
  @impl GenServer
  def format_status(status), do: Map.merge(status, %{state: :hidden, message: :hidden})
end

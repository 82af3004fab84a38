defmodule Aerie.Access.KeyRing do
  @moduledoc """
  The keys that open `/api` and the WebSocket at this moment: those of the configuration, and those that an admin made
  in the console. A file of the console's folder has the digests of the latter, in the form of `api.keys_file`; the key
  itself is shown once and kept nowhere.

  A request reads the list without waiting (`admit/2`). While this process restarts nobody is let in, because no keys
  at all would mean that programs of this machine need none.
  """
  use GenServer

  require Logger

  alias Aerie.Base.Names
  alias Aerie.Base.PubSub
  alias Aerie.Access.HTTP.Admission
  alias Aerie.Access.{Keys, PrivateFile, Users}
  alias Aerie.Access.Changes

  @most 100
  # The name of programs of this machine.
  @taken ["local"]
  @head "# Keys that were made in the console; of each its digest. A line goes with its key there: \"Revoke\".\n"
  @nobody [%{name: "nobody", digest: <<0::256>>, role: nil, permissions: [], until: nil}]

  @typedoc "What may be shown of a key. `made`: in the console, and can be revoked there."
  @type shown :: %{
          name: String.t(),
          role: Aerie.Control.Policy.Roles.role() | nil,
          permissions: [atom()],
          until: integer() | nil,
          made: boolean()
        }

  @doc "Options: `:gateway`, `:configured` (keys), `:file`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :api_keys))

  @doc "Keys that nothing opens: for a policy before `admit/2`."
  @spec nobody() :: [Keys.key()]
  def nobody, do: @nobody

  @doc "A policy with the keys of now."
  @spec admit(Admission.policy(), Names.gateway()) :: Admission.policy()
  def admit(policy, gateway) do
    case Names.value(gateway, :api_keys) do
      nil -> policy
      %{configured: configured, made: made} -> %{policy | keys: configured ++ made}
    end
  end

  @doc "The keys without what would help to use one."
  @spec list(Names.gateway()) :: [shown()]
  def list(gateway) do
    with %{configured: configured, made: made} <- Names.value(gateway, :api_keys),
         do: summary(configured, false) ++ summary(made, true),
         else: (nil -> [])
  end

  defp summary(keys, made?),
    do: for(key <- keys, do: key |> Map.take([:name, :role, :permissions, :until]) |> Map.put(:made, made?))

  @doc """
  Makes a key in the name of `by`; gives its text, which is known nowhere else. `expires`: a day as `2027-12-31`, or
  nothing.
  """
  @spec make(Names.gateway(), name :: term(), role :: term(), expires :: term(), Changes.by()) ::
          {:ok, String.t()} | {:error, String.t()}
  def make(gateway, name, role, expires, by) do
    text = Base.url_encode64(:crypto.strong_rand_bytes(24), padding: false)

    with :ok <- name(name),
         :ok <- parse_words([role, expires]),
         {:ok, key} <- Keys.make(name, text, [{"role", role}, {"expires", expires}]),
         :ok <- future(key),
         :ok <- call(gateway, {:add, key, by}),
         do: {:ok, text}
  end

  defp name(name) when name in @taken, do: {:error, "#{name} is what programs of this machine are called"}
  defp name(name), do: Users.name(name)

  # They become part of a line.
  defp parse_words(words) do
    if Enum.all?(words, &(is_binary(&1) and &1 =~ ~r/\A[a-z0-9-]{0,20}\z/)),
      do: :ok,
      else: {:error, "expected a role, and a day such as 2027-12-31 or nothing"}
  end

  defp future(%{until: until}) do
    if until == nil or until > System.os_time(:microsecond), do: :ok, else: {:error, "that day is over"}
  end

  @doc "Revokes a key that was made in the console: it opens nothing any more, and its WebSockets are closed."
  @spec revoke(Names.gateway(), String.t(), Changes.by()) :: :ok | {:error, String.t()}
  def revoke(gateway, name, by), do: call(gateway, {:revoke, name, by})

  defp call(gateway, request) do
    GenServer.call(Names.via(gateway, :api_keys), request)
  catch
    :exit, _gone -> {:error, "the gateway takes no changes of keys just now; try again"}
  end

  @impl GenServer
  def init(options) do
    Process.set_label(:api_keys)
    file = options[:file]

    case if(File.exists?(file), do: open(options[:gateway], file), else: {:ok, []}) do
      {:ok, made} ->
        {:ok, share(%{gateway: options[:gateway], file: file, configured: options[:configured], made: made})}

      {:error, text} ->
        {:stop, text}
    end
  end

  # In the place of damaged keys comes one that nothing opens: no key at all would let in every program of this machine.
  defp open(gateway, file) do
    damaged = [%{hd(@nobody) | name: "damaged"}]
    words = "the keys that were made in the console open nothing any more; make new ones"

    with {:ok, ^damaged} <- PrivateFile.open(gateway, file, &kept/1, words, damaged),
         :ok <- write(file, damaged),
         do: {:ok, damaged}
  end

  # Every file of ours has a first line, so an empty one lost its keys.
  defp kept(file) do
    if match?({:ok, %{size: 0}}, File.stat(file)), do: {:error, "#{file}: it is empty"}, else: Keys.read(file)
  end

  defp write(file, made), do: PrivateFile.write(file, [@head | Enum.map(made, &[Keys.line(&1), ?\n])])

  defp share(state) do
    Names.put_value(state.gateway, :api_keys, Map.take(state, [:configured, :made]))
    state
  end

  @impl GenServer
  def handle_call({:add, key, by}, _from, state) do
    cond do
      Enum.any?(state.configured ++ state.made, &(&1.name == key.name)) ->
        {:reply, {:error, "there is a key #{key.name} already"}, state}

      length(state.made) >= @most ->
        {:reply, {:error, "there are #{@most} keys already; revoke some first"}, state}

      true ->
        expires = key.until && key.until |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()
        said = %{"action" => "make", "key" => key.name, "role" => key.role, "expires" => expires}
        change(%{state | made: state.made ++ [key]}, state, by, said)
    end
  end

  def handle_call({:revoke, name, by}, _from, state) do
    case Enum.split_with(state.made, &(&1.name == name)) do
      {[], _made} ->
        {:reply, {:error, "#{name} was not made here: it is configured, or gone"}, state}

      {[_key], made} ->
        reply = change(%{state | made: made}, state, by, %{"action" => "revoke", "key" => name})
        PubSub.publish(state.gateway, {:notice, :api_keys}, name)
        reply
    end
  end

  # It holds once it is on the disk.
  defp change(new, old, by, said) do
    case write(new.file, new.made) do
      :ok ->
        Logger.info("the key #{said["key"]}: #{said["action"]} by #{Changes.name(by)}")
        Changes.note(new.gateway, by, "key", said)
        {:reply, :ok, share(new)}

      {:error, text} ->
        {:reply, {:error, text}, old}
    end
  end
end

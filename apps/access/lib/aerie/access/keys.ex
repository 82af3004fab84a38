defmodule Aerie.Access.Keys do
  @moduledoc """
  The API keys of clients. Only their digests stay in memory, and checking one takes the same time
  however close it is to a valid one.

  Keys come from `api.key` (best set in the environment) and from `api.keys_file`, one per line:

      KEY
      NAME KEY
      NAME KEY role=operator permissions=force_disarm expires=2027-12-31
      NAME sha256:DIGEST role=viewer

  `#` begins a comment, at the start of a line or behind a space. Each name and each key is there once. `sha256:` and 64 hexadecimal digits stand for the key with this digest (`printf %s KEY | sha256sum`), so
  that the file does not reveal it. A file that others than its owner can read is refused, as in ssh. A key has at least 16
  characters, so that guessing is hopeless at any rate; make keys random.

  | role | may |
  |---|---|
  | `viewer` | read, and open a WebSocket that only reads |
  | `operator`, `admin` | everything; its commands, also by WebSocket, are subject to that role's policy (`Aerie.Control.Policy.Roles`) |
  | none given | everything; a WebSocket is subject to `policy.clients` |

  A key is valid until the end of the day (UTC) on which it expires.
  """

  alias Aerie.Vehicle.Command.Type
  alias Aerie.Control.Policy.Roles
  alias Aerie.Base.{Principal, Secret}
  alias Aerie.Access.{Principals, PrivateFile}

  @shortest 16
  @longest 512

  @typedoc "A key by its digest. `until`: unix microseconds, nil for ever; `role`: nil if none is given."
  @type key :: %{
          name: String.t(),
          digest: binary(),
          role: Roles.role() | nil,
          permissions: [Type.permission()],
          until: integer() | nil
        }

  @doc "The smallest number of characters of a key."
  @spec shortest() :: pos_integer()
  def shortest, do: @shortest

  @doc "The keys of the configuration's section `api`; `[]` if there are none."
  @spec load(%{key: Secret.t() | nil, keys_file: Path.t() | nil}) :: {:ok, [key()]} | {:error, String.t()}
  def load(%{key: key, keys_file: file}) do
    own = if key, do: [new("api.key", digest(Secret.reveal(key)))], else: []

    with {:ok, listed} <- read(file), nil <- twice(own ++ listed) do
      {:ok, own ++ listed}
    else
      {:error, text} -> {:error, text}
      what -> {:error, "#{file}: #{what}"}
    end
  end

  @doc "The keys of a file; `[]` for no file at all (nil)."
  @spec read(Path.t() | nil) :: {:ok, [key()]} | {:error, String.t()}
  def read(nil), do: {:ok, []}

  def read(path) do
    with {:ok, text} <- PrivateFile.read(path),
         true <- String.valid?(text) || {:error, "#{path}: expected text, got other bytes"} do
      lines(path, text)
    else
      {:error, :enoent} -> {:error, "#{path}: #{:file.format_error(:enoent)}"}
      {:error, text} -> {:error, text}
    end
  end

  @doc "A key's line in a file, with its digest only."
  @spec line(key()) :: String.t()
  def line(key) do
    fields = [
      key.role && "role=#{key.role}",
      key.permissions != [] && "permissions=" <> Enum.join(key.permissions, ","),
      key.until && "expires=#{day(key.until)}"
    ]

    Enum.join(
      [key.name, "sha256:" <> Base.encode16(key.digest, case: :lower) | Enum.filter(fields, & &1)],
      " "
    )
  end

  @doc "A key of a name and a text, with the words of a line (`role`, `expires`) as somebody typed them."
  @spec make(String.t(), String.t(), [{String.t(), String.t()}]) :: {:ok, key()} | {:error, String.t()}
  def make(name, text, words) do
    words = for {field, word} <- words, word != "", do: "#{field}=#{word}"
    with {:ok, fields} <- fields(words, %{}), do: {:ok, new(name, digest(text), fields)}
  end

  @doc "Whose key was presented, or `:unknown`. `now` in unix microseconds."
  @spec check([key()], term(), now :: integer()) ::
          {:ok, Principal.t()} | {:error, :unknown | {:expired, Date.t()}}
  def check(keys, presented, now \\ System.os_time(:microsecond))

  def check(keys, presented, now) when is_binary(presented) and byte_size(presented) <= @longest do
    digest = digest(presented)

    # All keys are compared, even after a match, so that the time reveals nothing.
    found =
      Enum.reduce(keys, nil, fn key, found ->
        if :crypto.hash_equals(key.digest, digest), do: key, else: found
      end)

    case found do
      nil -> {:error, :unknown}
      %{until: until} when until != nil and now >= until -> {:error, {:expired, day(until)}}
      key -> {:ok, Principals.of(key)}
    end
  end

  def check(_keys, _presented, _now), do: {:error, :unknown}

  defp new(name, digest, fields \\ %{}),
    do:
      Map.merge(
        %{name: String.slice(name, 0, 64), digest: digest, role: nil, permissions: [], until: nil},
        fields
      )

  defp day(until), do: DateTime.from_unix!(until - 1, :microsecond) |> DateTime.to_date()

  defp digest(key), do: :crypto.hash(:sha256, key)

  # No message may quote a line, because it may be a misspelt key.
  defp lines(path, text) do
    text
    |> String.split(["\r\n", "\n"])
    |> Enum.with_index(1)
    |> Enum.reduce_while({:ok, []}, fn {line, n}, {:ok, keys} ->
      case line |> String.replace(~r/(^|\s)#.*/u, "") |> String.split() do
        [] -> {:cont, {:ok, keys}}
        [key] -> one(path, n, "line #{n}", key, [], keys)
        [name, key | fields] -> one(path, n, name, key, fields, keys)
      end
    end)
    |> case do
      {:ok, keys} -> {:ok, Enum.reverse(keys)}
      error -> error
    end
  end

  defp one(path, n, name, key, fields, keys) do
    with :ok <- name(name),
         {:ok, digest} <- key_digest(key),
         {:ok, fields} <- fields(fields, %{}),
         key = new(name, digest, fields),
         nil <- twice([key | keys]) do
      {:cont, {:ok, [key | keys]}}
    else
      {:error, what} -> {:halt, {:error, "#{path} line #{n}: #{what}"}}
      what -> {:halt, {:error, "#{path} line #{n}: #{what}"}}
    end
  end

  # Which of two counts, nobody could tell.
  defp twice(keys) do
    cond do
      keys |> Enum.uniq_by(& &1.name) |> length() < length(keys) ->
        "each name once; this one is there already"

      keys |> Enum.uniq_by(& &1.digest) |> length() < length(keys) ->
        "each key once; this one is there already"

      true ->
        nil
    end
  end

  # It is in the log, and two names with the same beginning must not be taken for one.
  defp name(name) when byte_size(name) <= 64, do: :ok
  defp name(_name), do: {:error, "a name has at most 64 bytes"}

  defp key_digest("sha256:" <> hex) do
    case Base.decode16(hex, case: :mixed) do
      {:ok, <<digest::binary-size(32)>>} -> {:ok, digest}
      _other -> {:error, "sha256: is followed by 64 hexadecimal digits"}
    end
  end

  defp key_digest(key) do
    cond do
      # `KEY role=viewer` without a name: the field would be the key, and anybody could guess it.
      field?(key) ->
        {:error,
         "expected KEY, or NAME KEY and then role=, permissions= or expires=; here a field is where the key should be"}

      String.contains?(key, "#") ->
        {:error, "# is not allowed in a key; a comment begins behind a space"}

      true ->
        plain_digest(key)
    end
  end

  defp plain_digest(key) when byte_size(key) in @shortest..@longest, do: {:ok, digest(key)}
  defp plain_digest(_key), do: {:error, "a key has #{@shortest} to #{@longest} characters"}

  @fields ~w(role permissions expires)
  @alike 0.8

  # Misspelt or in capitals too.
  defp field?(word) do
    case String.split(word, "=", parts: 2) do
      [name, value] when value != "" ->
        Enum.any?(@fields, &(String.jaro_distance(String.downcase(name), &1) >= @alike))

      _no_field ->
        false
    end
  end

  defp fields([], %{role: :viewer, permissions: [_ | _]}),
    do: {:error, "role=viewer has no permissions=: a viewer may do nothing; give role=operator"}

  defp fields([], known), do: {:ok, known}

  defp fields([word | rest], known) do
    with [name, value] <- String.split(word, "=", parts: 2),
         {:ok, field, value} <- field(name, value),
         false <- is_map_key(known, field) do
      fields(rest, Map.put(known, field, value))
    else
      true -> {:error, "each of role=, permissions= and expires= once"}
      {:error, text} -> {:error, text}
      _no_field -> {:error, "expected KEY, NAME KEY, or NAME KEY with role=, permissions= and expires="}
    end
  end

  defp field("role", text) do
    case Enum.find(Roles.all(), &(Atom.to_string(&1) == text)) do
      nil -> {:error, "role= expects #{Enum.join(Roles.all(), ", ")}"}
      role -> {:ok, :role, role}
    end
  end

  defp field("permissions", text) do
    found =
      for name <- String.split(text, ","), do: Enum.find(Type.permissions(), &(Atom.to_string(&1) == name))

    if nil in found,
      do: {:error, "permissions= expects #{Enum.join(Type.permissions(), ", ")}, with commas between them"},
      else: {:ok, :permissions, found}
  end

  defp field("expires", text) do
    case Date.from_iso8601(text) do
      {:ok, day} ->
        {:ok, :until, day |> Date.add(1) |> DateTime.new!(~T[00:00:00]) |> DateTime.to_unix(:microsecond)}

      {:error, _reason} ->
        {:error, "expires= expects a day such as 2027-12-31"}
    end
  end

  defp field(_other, _value), do: :error
end

defmodule Aerie.Client.Keys do
  @moduledoc """
  The keys that clients show to be let in. Only their digests stay in memory, and checking one takes the same time
  whether it is nearly right or not at all.

  Keys come from `api.key` (best by the environment) and from `api.keys_file`: one a line, `KEY` or `NAME KEY`, `#` for
  comments. A file that others than its owner can read is refused, as ssh does. A key has at least 16 characters, so
  that guessing is hopeless at any rate of tries.
  """

  import Bitwise

  alias Aerie.Secret

  @shortest 16
  @longest 512
  @max_file 65_536

  @typedoc "A name, for the log and the list of clients, and the digest of the key."
  @type key :: {name :: String.t(), digest :: binary()}

  @doc "The fewest characters a key may have."
  @spec shortest() :: pos_integer()
  def shortest, do: @shortest

  @doc "The keys of the configuration's section `api`; `[]` when there is none."
  @spec load(%{key: Secret.t() | nil, keys_file: Path.t() | nil}) :: {:ok, [key()]} | {:error, String.t()}
  def load(%{key: key, keys_file: file}) do
    own = if key, do: [{"api.key", digest(Secret.reveal(key))}], else: []
    with {:ok, listed} <- read(file), do: {:ok, own ++ listed}
  end

  @doc "The name of the key that was presented; `:error` for none of ours."
  @spec check([key()], term()) :: {:ok, String.t()} | :error
  def check(keys, presented) when is_binary(presented) and byte_size(presented) <= @longest do
    digest = digest(presented)

    # All are compared, whichever fits.
    Enum.reduce(keys, :error, fn {name, known}, found ->
      if :crypto.hash_equals(known, digest), do: {:ok, name}, else: found
    end)
  end

  def check(_keys, _presented), do: :error

  @doc "Whether an address is this machine's own: 127.0.0.0/8, ::1, and the first one written as IPv6."
  @spec loopback?(:inet.ip_address()) :: boolean()
  def loopback?({127, _, _, _}), do: true
  def loopback?({0, 0, 0, 0, 0, 0, 0, 1}), do: true
  def loopback?({0, 0, 0, 0, 0, 0xFFFF, high, _low}), do: high >>> 8 == 127
  def loopback?(_address), do: false

  defp digest(key), do: :crypto.hash(:sha256, key)

  defp read(nil), do: {:ok, []}

  defp read(path) do
    with {:ok, stat} <- File.stat(path),
         :ok <- private(path, stat),
         {:ok, text} <- File.read(path) do
      lines(path, text)
    else
      {:error, text} when is_binary(text) -> {:error, text}
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  defp private(path, %File.Stat{type: :regular, mode: mode, size: size}) do
    cond do
      (mode &&& 0o077) != 0 ->
        {:error,
         "#{path} can be read by others (mode #{Integer.to_string(mode &&& 0o777, 8)}): chmod 600 #{path}"}

      size > @max_file ->
        {:error, "#{path} is larger than #{@max_file} bytes"}

      true ->
        :ok
    end
  end

  defp private(path, _stat), do: {:error, "#{path} is not a file"}

  # No message may quote a line: it may be a key with something wrong about it.
  defp lines(path, text) do
    text
    |> String.split(["\r\n", "\n"])
    |> Enum.with_index(1)
    |> Enum.reduce_while({:ok, []}, fn {line, n}, {:ok, keys} ->
      case line |> String.replace(~r/#.*/, "") |> String.split() do
        [] -> {:cont, {:ok, keys}}
        [key] -> one(path, n, "line #{n}", key, keys)
        [name, key] -> one(path, n, name, key, keys)
        _more -> {:halt, {:error, "#{path} line #{n}: expected KEY or NAME KEY"}}
      end
    end)
    |> case do
      {:ok, keys} -> {:ok, Enum.reverse(keys)}
      error -> error
    end
  end

  defp one(_path, _n, name, key, keys) when byte_size(key) in @shortest..@longest,
    do: {:cont, {:ok, [{String.slice(name, 0, 64), digest(key)} | keys]}}

  defp one(path, n, _name, _key, _keys),
    do: {:halt, {:error, "#{path} line #{n}: a key has #{@shortest} to #{@longest} characters"}}
end

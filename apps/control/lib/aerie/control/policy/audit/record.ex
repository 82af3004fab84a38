defmodule Aerie.Control.Policy.Audit.Record do
  @moduledoc """
  One record of the audit log: a line of JSON that carries the hash of the line before it and ends with its own.

      {"n":7,"at":"2026-11-22T09:30:00.123456Z","prev":"…","type":"decision", … ,"hash":"…"}

  `hash` is the SHA-256, in hexadecimal, of the line's bytes before `,"hash":`. With the file alone it can be checked without
  this program.
  """

  @max_bytes 16_384
  @start String.duplicate("0", 64)
  # `,"hash":"` and 64 digits and `"}`
  @tail_bytes 75
  @own ~w(n at prev hash)

  @type t :: %{n: pos_integer(), prev: String.t(), hash: String.t(), fields: %{String.t() => term()}}

  @doc "The previous hash of the first record."
  @spec start() :: String.t()
  def start, do: @start

  @doc "The longest line in bytes, its end included."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc """
  The line of an entry, its newline included, and its hash. What is not text becomes hexadecimal; an entry that is too long keeps
  its short values and says that it was cut.
  """
  @spec encode(%{String.t() => term()}, pos_integer(), String.t(), at :: integer()) ::
          {binary(), hash :: String.t()}
  def encode(entry, n, prev, at) do
    entry = entry |> Map.drop(@own) |> plain()
    time = at |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()
    head = ~s({"n":#{n},"at":"#{time}","prev":"#{prev}")

    body =
      case fields(entry) do
        long when byte_size(long) > @max_bytes - 512 -> entry |> cut() |> fields()
        short -> short
      end

    prefix = head <> body
    hash = hash(prefix)
    {prefix <> ~s(,"hash":"#{hash}"}\n), hash}
  end

  @doc "A line without its newline; `:error` for one that no log of this program wrote, or that was changed since."
  @spec decode(binary()) :: {:ok, t()} | :error
  def decode(line) when byte_size(line) > @tail_bytes and byte_size(line) <= @max_bytes do
    size = byte_size(line) - @tail_bytes

    with <<prefix::binary-size(^size), ~s(,"hash":"), hash::binary-size(64), ~s("})>> <- line,
         ^hash <- hash(prefix),
         {:ok, %{"n" => n, "prev" => prev} = fields} when is_integer(n) and is_binary(prev) <-
           JSON.decode(line) do
      {:ok, %{n: n, prev: prev, hash: hash, fields: fields}}
    else
      _other -> :error
    end
  end

  def decode(_line), do: :error

  @doc "The SHA-256 of some bytes in hexadecimal."
  @spec hash(binary()) :: String.t()
  def hash(bytes), do: :sha256 |> :crypto.hash(bytes) |> Base.encode16(case: :lower)

  # Without the bracket that opens the object.
  defp fields(entry) when entry == %{}, do: ""

  defp fields(entry) do
    "{" <> rest = JSON.encode!(entry)
    "," <> binary_part(rest, 0, byte_size(rest) - 1)
  end

  defp cut(entry) do
    entry
    |> Enum.filter(fn {key, value} -> byte_size(key) + byte_size(JSON.encode!(value)) <= 256 end)
    |> Enum.sort()
    |> Enum.take(32)
    |> Map.new()
    |> Map.put("cut", true)
  end

  defp plain(map) when is_map(map) and not is_struct(map),
    do: Map.new(map, fn {key, value} -> {key |> to_string() |> plain(), plain(value)} end)

  defp plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  defp plain(atom) when is_atom(atom) and atom not in [nil, true, false], do: Atom.to_string(atom)

  defp plain(text) when is_binary(text) do
    if String.valid?(text), do: text, else: Base.encode16(text, case: :lower)
  end

  defp plain(other), do: other
end

defmodule Gnat.Parsec do
  @max_line 65_536

  @moduledoc """
  Parses what the server sends: takes bytes in any chunks, returns whole messages.

  A value, not a process. Garbage is an error, never an exception, and what it keeps is bounded (a control line of at
  most #{div(@max_line, 1024)} KiB, a body of at most `:max_body` bytes). After an error the connection must be closed,
  because the start of the next message cannot be found.

  There are three cases: whole lines and bodies inside one read (the usual case; bodies are parts of the bytes read); a line
  cut off at the end of a read (it is kept, and only its new part is searched); an incomplete body (its pieces are
  collected and joined once, so that a body in n reads costs n steps and not n^2).
  """

  alias Gnat.{Headers, ServerInfo}

  # The largest max_payload that nats-server can be configured with, and room for headers.
  @max_body 64 * 1024 * 1024 + 65_536

  defstruct line: "", searched: 0, body: nil, max_body: @max_body

  @opaque t :: %__MODULE__{
            line: binary(),
            searched: non_neg_integer(),
            body: nil | {head :: tuple(), missing :: pos_integer(), pieces :: [binary()]},
            max_body: pos_integer()
          }

  @typedoc "`headers_size` of a body is always within it; `reply_to` is nil when there is none."
  @type message ::
          {:info, Gnat.server_info()}
          | {:msg, subject :: binary(), sid :: non_neg_integer(), reply_to :: binary() | nil,
             body :: binary()}
          | {:hmsg, subject :: binary(), sid :: non_neg_integer(), reply_to :: binary() | nil,
             Headers.decoded(), body :: binary()}
          | :ping
          | :pong
          | :ok
          | {:error, text :: String.t()}

  @spec new(max_body: pos_integer()) :: t()
  def new(opts \\ []), do: %__MODULE__{max_body: Keyword.get(opts, :max_body, @max_body)}

  @doc """
  Takes the bytes of one read. Messages come in the order of the wire; before an error, those that were whole before it.
  """
  @spec parse(t(), binary()) :: {:ok, t(), [message()]} | {:error, String.t(), [message()]}
  def parse(%__MODULE__{body: nil, line: ""} = parser, bytes), do: lines(parser, bytes, [])

  def parse(%__MODULE__{body: nil, line: line} = parser, bytes) do
    lines(%{parser | line: ""}, line <> bytes, [])
  end

  def parse(%__MODULE__{body: {head, missing, pieces}} = parser, bytes) do
    if byte_size(bytes) < missing do
      {:ok, %{parser | body: {head, missing - byte_size(bytes), [bytes | pieces]}}, []}
    else
      <<last::binary-size(^missing), rest::binary>> = bytes
      whole = [last | pieces] |> Enum.reverse() |> IO.iodata_to_binary()
      finish(%{parser | body: nil}, head, whole, rest, [])
    end
  end

  @doc "Whether nothing is held back: no part of a line and no part of a body."
  @spec empty?(t()) :: boolean()
  def empty?(%__MODULE__{line: line, body: body}), do: line == "" and body == nil

  defp lines(parser, "", messages), do: {:ok, %{parser | line: "", searched: 0}, Enum.reverse(messages)}

  defp lines(%{searched: searched} = parser, bytes, messages) do
    case :binary.match(bytes, "\n", scope: {searched, byte_size(bytes) - searched}) do
      {at, 1} when at < @max_line ->
        <<line::binary-size(^at), ?\n, rest::binary>> = bytes
        command(%{parser | searched: 0}, chomp(line), rest, messages)

      :nomatch when byte_size(bytes) <= @max_line ->
        {:ok, %{parser | line: bytes, searched: byte_size(bytes)}, Enum.reverse(messages)}

      _too_long ->
        error("a control line of more than #{@max_line} bytes", messages)
    end
  end

  defp command(parser, "MSG " <> args, rest, messages), do: msg(parser, args, rest, messages)
  defp command(parser, "HMSG " <> args, rest, messages), do: hmsg(parser, args, rest, messages)
  defp command(parser, "PING", rest, messages), do: lines(parser, rest, [:ping | messages])
  defp command(parser, "PONG", rest, messages), do: lines(parser, rest, [:pong | messages])
  defp command(parser, "+OK", rest, messages), do: lines(parser, rest, [:ok | messages])

  defp command(parser, "-ERR" <> text, rest, messages) do
    lines(parser, rest, [{:error, text |> printable() |> String.trim() |> String.trim("'")} | messages])
  end

  defp command(parser, "INFO " <> json, rest, messages) do
    case ServerInfo.decode(json) do
      {:ok, info} -> lines(parser, rest, [{:info, info} | messages])
      {:error, reason} -> error(reason, messages)
    end
  end

  defp command(_parser, line, _rest, messages) do
    error("unknown command #{line |> binary_part(0, min(byte_size(line), 40)) |> inspect()}", messages)
  end

  defp msg(parser, args, rest, messages) do
    with [subject, sid, reply_to, size] <- fields(args, 3),
         sid when is_integer(sid) <- integer(sid),
         size when is_integer(size) and size <= parser.max_body <- integer(size) do
      body(parser, {:msg, subject, sid, reply_to, size}, size + 2, rest, messages)
    else
      _bad -> error("bad MSG line #{excerpt(args)}", messages)
    end
  end

  defp hmsg(parser, args, rest, messages) do
    with [subject, sid, reply_to, header_size, size] <- fields(args, 4),
         sid when is_integer(sid) <- integer(sid),
         size when is_integer(size) and size <= parser.max_body <- integer(size),
         header_size when is_integer(header_size) and header_size <= size <- integer(header_size) do
      body(parser, {:hmsg, subject, sid, reply_to, header_size, size}, size + 2, rest, messages)
    else
      _bad -> error("bad HMSG line #{excerpt(args)}", messages)
    end
  end

  defp body(parser, head, needed, bytes, messages) do
    if byte_size(bytes) < needed do
      pieces = if bytes == "", do: [], else: [bytes]
      {:ok, %{parser | body: {head, needed - byte_size(bytes), pieces}}, Enum.reverse(messages)}
    else
      <<whole::binary-size(^needed), rest::binary>> = bytes
      finish(parser, head, whole, rest, messages)
    end
  end

  defp finish(parser, {:msg, subject, sid, reply_to, size}, whole, rest, messages) do
    case whole do
      <<body::binary-size(^size), "\r\n">> ->
        lines(parser, rest, [{:msg, subject, sid, reply_to, body} | messages])

      _other ->
        error("a body that does not end where it should", messages)
    end
  end

  defp finish(parser, {:hmsg, subject, sid, reply_to, header_size, size}, whole, rest, messages) do
    body_size = size - header_size

    case whole do
      <<block::binary-size(^header_size), body::binary-size(^body_size), "\r\n">> ->
        lines(parser, rest, [{:hmsg, subject, sid, reply_to, Headers.decode(block), body} | messages])

      _other ->
        error("a body that does not end where it should", messages)
    end
  end

  # subject, sid, optional reply address, then the sizes; `least` fields without the reply address.
  defp fields(args, least) do
    fields = :binary.split(args, [" ", "\t"], [:global, :trim_all])

    case length(fields) - least do
      0 -> List.insert_at(fields, 2, nil)
      1 -> fields
      _other -> :error
    end
  end

  # Up to 15 digits: more than any size or subscription id, and never a bignum.
  defp integer(digits) when byte_size(digits) in 1..15, do: integer(digits, 0)
  defp integer(_digits), do: :error

  defp integer(<<digit, rest::binary>>, sum) when digit in ?0..?9, do: integer(rest, sum * 10 + digit - ?0)
  defp integer("", sum), do: sum
  defp integer(_other, _sum), do: :error

  defp chomp(line) do
    size = byte_size(line) - 1

    case line do
      <<chomped::binary-size(^size), ?\r>> when size >= 0 -> chomped
      _bare -> line
    end
  end

  defp printable(text), do: if(String.valid?(text), do: text, else: inspect(text))
  defp excerpt(args), do: args |> binary_part(0, min(byte_size(args), 80)) |> inspect()
  defp error(reason, messages), do: {:error, reason, Enum.reverse(messages)}
end

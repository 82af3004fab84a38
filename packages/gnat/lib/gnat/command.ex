defmodule Gnat.Command do
  @moduledoc """
  The client's commands, as iodata.

  Subjects, reply addresses and queue groups are checked here, because a blank or a line break in one would be read as
  another command by the server.
  """

  alias Gnat.{Error, Headers}

  # The server reads no control line above 4096 bytes; a subject, a reply address and the numbers must fit.
  @max_subject 1024

  @type built :: {:ok, iodata(), payload_size :: non_neg_integer()} | {:error, Error.t()}

  @doc "PUB, or HPUB when there are headers. The size is what the server compares with its `max_payload`."
  @spec pub(String.t(), iodata(), String.t() | nil, Headers.t()) :: built()
  def pub(subject, payload, reply_to, headers) do
    size = IO.iodata_length(payload)

    with :ok <- check(subject),
         :ok <- if(reply_to, do: check(reply_to), else: :ok) do
      pub(subject, payload, size, reply_to, headers)
    end
  end

  defp pub(subject, payload, size, reply_to, []) do
    {:ok, ["PUB ", subject, ?\s, reply(reply_to), Integer.to_string(size), "\r\n", payload, "\r\n"], size}
  end

  defp pub(subject, payload, size, reply_to, headers) do
    with {:ok, block} <- Headers.encode(headers) do
      block_size = IO.iodata_length(block)
      total = block_size + size
      sizes = [Integer.to_string(block_size), ?\s, Integer.to_string(total)]
      {:ok, ["HPUB ", subject, ?\s, reply(reply_to), sizes, "\r\n", block, payload, "\r\n"], total}
    end
  end

  @doc "SUB, with or without a queue group."
  @spec sub(String.t(), non_neg_integer(), String.t() | nil) :: {:ok, iodata()} | {:error, Error.t()}
  def sub(subject, sid, queue_group) do
    with :ok <- check(subject),
         :ok <- if(queue_group, do: check(queue_group), else: :ok) do
      {:ok, ["SUB ", subject, ?\s, reply(queue_group), Integer.to_string(sid), "\r\n"]}
    end
  end

  @spec unsub(non_neg_integer()) :: iodata()
  def unsub(sid), do: ["UNSUB ", Integer.to_string(sid), "\r\n"]

  @spec connect(map()) :: iodata()
  def connect(options), do: ["CONNECT ", JSON.encode_to_iodata!(options), "\r\n"]

  @spec ping() :: iodata()
  def ping, do: "PING\r\n"

  @spec pong() :: iodata()
  def pong, do: "PONG\r\n"

  @doc "Whether this can be a subject in a command: 1 to 1024 visible bytes."
  @spec check(term()) :: :ok | {:error, Error.t()}
  def check(subject) when is_binary(subject) and subject != "" and byte_size(subject) <= @max_subject do
    if visible?(subject), do: :ok, else: {:error, Error.new({:invalid_subject, subject})}
  end

  def check(other), do: {:error, Error.new({:invalid_subject, other})}

  defp visible?(<<byte, rest::binary>>) when byte > 32 and byte != 127, do: visible?(rest)
  defp visible?(rest), do: rest == ""

  defp reply(nil), do: []
  defp reply(subject), do: [subject, ?\s]
end

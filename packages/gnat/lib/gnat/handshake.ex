defmodule Gnat.Handshake do
  @moduledoc """
  Connects and logs in: TCP, INFO, TLS, CONNECT with the credentials, and a PING whose PONG shows that the server accepted
  them. All of it within `connection_timeout`, in the calling process.
  """

  alias Gnat.{Auth, Command, Error, Parsec, Settings, Transport}

  @enforce_keys [:transport, :parser, :info, :settings]
  defstruct @enforce_keys

  @typedoc "An accepted connection, still passive: its final owner activates it."
  @type t :: %__MODULE__{
          transport: Transport.t(),
          parser: Parsec.t(),
          info: Gnat.server_info(),
          settings: Settings.t()
        }

  @spec connect(map()) :: {:ok, t()} | {:error, Error.t()}
  def connect(settings) do
    with {:ok, settings} <- Settings.new(settings),
         deadline = Transport.deadline(settings.connection_timeout),
         {:ok, transport} <- Transport.connect(settings, deadline) do
      secure(transport, settings, deadline)
    end
  end

  # A failed upgrade has closed its socket; afterwards the newest transport must be closed.
  defp secure(transport, settings, deadline) do
    with {:ok, info, parser} <- info(transport, deadline),
         {:ok, transport} <- tls(transport, info, parser, settings, deadline) do
      connection = %__MODULE__{transport: transport, parser: parser, info: info, settings: settings}
      with {:error, error} <- log_in(connection, deadline), do: close(transport, error)
    end
  end

  defp upgrade(transport, settings, deadline) do
    with {:error, error} <- Transport.upgrade(transport, settings, deadline), do: close(transport, error)
  end

  defp info(transport, deadline) do
    with {:error, error} <- read_info(transport, Parsec.new(), deadline), do: close(transport, error)
  end

  defp read_info(transport, parser, deadline) do
    with {:ok, bytes} <- Transport.recv(transport, deadline) do
      case Parsec.parse(parser, bytes) do
        {:ok, parser, []} -> read_info(transport, parser, deadline)
        {:ok, parser, [{:info, info}]} -> {:ok, info, parser}
        {_, _, [{:error, text} | _]} -> {:error, server_error(text)}
        {:error, why, _} -> {:error, Error.new({:protocol, why})}
        {:ok, _, _other} -> {:error, Error.new({:protocol, "the server does not begin with INFO"})}
      end
    end
  end

  defp tls(transport, info, parser, settings, deadline) do
    offered? = info[:tls_required] || info[:tls_available] || false

    cond do
      settings.tls and not offered? ->
        close(transport, Error.new(:tls_not_offered))

      not (settings.tls or info[:tls_required] == true) ->
        {:ok, transport}

      # Bytes behind a plain INFO could come from anybody; they must not be treated as if they came through TLS.
      not Parsec.empty?(parser) ->
        close(transport, Error.new({:protocol, "bytes between INFO and TLS"}))

      true ->
        upgrade(transport, settings, deadline)
    end
  end

  defp log_in(%{transport: transport, info: info, settings: settings} = connection, deadline) do
    with {:ok, options} <- options(info, settings, transport),
         :ok <- Transport.send(transport, [Command.connect(options), Command.ping()]) do
      await_pong(connection, deadline)
    end
  end

  defp options(info, settings, transport) do
    headers? = info[:headers] == true

    with {:ok, auth} <- Auth.options(info, settings) do
      {:ok,
       %{
         verbose: false,
         pedantic: false,
         protocol: 1,
         lang: "elixir",
         version: version(),
         tls_required: transport.kind == :tls,
         headers: headers?,
         no_responders: headers? and settings.no_responders
       }
       |> Map.merge(Map.take(settings, [:name]))
       |> Map.merge(auth)}
    end
  end

  defp await_pong(connection, deadline) do
    case Transport.recv(connection.transport, deadline) do
      {:ok, bytes} ->
        case Parsec.parse(connection.parser, bytes) do
          {:ok, parser, messages} -> answer(messages, %{connection | parser: parser}, deadline)
          {:error, _why, [{:error, text} | _]} -> {:error, server_error(text)}
          {:error, why, _messages} -> {:error, Error.new({:protocol, why})}
        end

      {:error, error} ->
        {:error, error}
    end
  end

  # Nothing is subscribed yet, so nothing but these can come. `:done`: the PONG was read; what came with it counts.
  defp answer([], connection, :done), do: {:ok, connection}
  defp answer([], connection, deadline), do: await_pong(connection, deadline)
  defp answer([:pong | rest], connection, _deadline), do: answer(rest, connection, :done)
  defp answer([{:error, text} | _], _connection, _deadline), do: {:error, server_error(text)}

  defp answer([{:info, info} | rest], connection, deadline),
    do: answer(rest, %{connection | info: info}, deadline)

  defp answer([:ping | rest], connection, deadline) do
    with :ok <- Transport.send(connection.transport, Command.pong()), do: answer(rest, connection, deadline)
  end

  defp answer([:ok | rest], connection, deadline), do: answer(rest, connection, deadline)

  defp answer([_message | _], _connection, _deadline) do
    {:error, Error.new({:protocol, "a message before the answer to CONNECT"})}
  end

  defp server_error(text) do
    if text =~ ~r/authori[sz]ation|authentication|credential|expired|revoked/i do
      Error.new({:auth, text})
    else
      Error.new({:server, text})
    end
  end

  defp close(transport, error) do
    Transport.close(transport)
    {:error, error}
  end

  defp version, do: to_string(Application.spec(:gnat, :vsn) || "0")
end

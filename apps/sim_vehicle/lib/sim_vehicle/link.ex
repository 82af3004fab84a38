defmodule SimVehicle.Link do
  @moduledoc """
  A transport as a value. The process that opens it passes the messages of its sockets to `handle/2`.

  | address | the vehicle |
  |---|---|
  | `udpout:HOST:PORT` | sends to that address from its own port, and receives answers |
  | `udpin:HOST:PORT` | listens there; sends to the last sender, and nothing before it has one |
  | `tcpin:HOST:PORT` | listens as SITL does; one connection at a time |
  | `tcp:HOST:PORT` | connects; retries every half second if the connection is refused or lost |

  Port 0 of `udpin` and `tcpin` takes a free port, which `port/1` returns.
  """

  alias SimVehicle.Link.{Tcp, Udp}

  @typedoc "The struct of the module that implements the transport."
  @type t :: struct

  @typedoc "The meaning of a socket's message."
  @type outcome :: {:data, binary, t} | {:up, t} | {:down, t} | {:ok, t} | :unknown

  @callback open(kind :: atom, :inet.ip_address(), :inet.port_number()) :: {:ok, t} | {:error, term}
  @callback handle(t, message :: term) :: outcome
  @callback send_bytes(t, iodata) :: {:sent | :dropped, t}
  @callback port(t) :: :inet.port_number()
  @callback drop(t) :: t
  @callback close(t) :: :ok

  @kinds %{
    "udpout" => {Udp, :client},
    "udpin" => {Udp, :server},
    "tcp" => {Tcp, :client},
    "tcpin" => {Tcp, :server}
  }

  @doc "Checks an address and splits it; the error says what was expected."
  @spec parse(String.t()) ::
          {:ok, {module, atom, :inet.ip_address(), :inet.port_number()}} | {:error, String.t()}
  def parse(address) when is_binary(address) do
    with [kind, host, port] <- String.split(address, ":"),
         {:ok, {module, role}} <- Map.fetch(@kinds, kind),
         {:ok, ip} <- resolve(host),
         {port, ""} when port in 0..65_535 <- Integer.parse(port) do
      {:ok, {module, role, ip, port}}
    else
      _malformed -> {:error, expected(address)}
    end
  end

  def parse(other), do: {:error, expected(other)}

  @doc "Opens a parsed address; the calling process owns the sockets."
  @spec open({module, atom, :inet.ip_address(), :inet.port_number()}) :: {:ok, t} | {:error, term}
  def open({module, role, ip, port}), do: module.open(role, ip, port)

  @doc "Handles a message from the owner's mailbox; `:unknown` if it does not belong to this link."
  @spec handle(t, term) :: outcome
  def handle(%module{} = link, message), do: module.handle(link, message)

  @doc "Sends one frame, or drops it while there is no peer."
  @spec send_bytes(t, iodata) :: {:sent | :dropped, t}
  def send_bytes(%module{} = link, bytes), do: module.send_bytes(link, bytes)

  @doc "The local port."
  @spec port(t) :: :inet.port_number()
  def port(%module{} = link), do: module.port(link)

  @doc "Drops the connection, as a reboot does; a server keeps listening."
  @spec drop(t) :: t
  def drop(%module{} = link), do: module.drop(link)

  @doc "Closes everything."
  @spec close(t) :: :ok
  def close(%module{} = link), do: module.close(link)

  defp resolve(host) do
    case :inet.getaddr(String.to_charlist(host), :inet) do
      {:ok, ip} -> {:ok, ip}
      {:error, _reason} -> :error
    end
  end

  defp expected(got),
    do: "expected udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or tcpin:HOST:PORT, got: #{inspect(got)}"
end

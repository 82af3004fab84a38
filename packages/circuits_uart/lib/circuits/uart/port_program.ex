defmodule Circuits.UART.PortProgram do
  @moduledoc false
  # The operating-system process that holds the port: where it is, and how to talk to it.

  @doc "The path at which the build puts it."
  @spec path() :: Path.t()
  def path, do: Application.app_dir(:circuits_uart, ["priv", "circuits_uart"])

  @doc "Starts one, linked to the caller. Its packets come as `{port, {:data, packet}}`."
  @spec start(Path.t()) :: {:ok, port()} | {:error, atom()}
  def start(path) do
    {:ok, Port.open({:spawn_executable, path}, [:binary, :exit_status, :use_stdio, packet: 2, args: []])}
  rescue
    error in ErlangError ->
      {:error, if(error.original in [:enoent, :eacces], do: :port_program_missing, else: error.original)}
  end

  @doc "Sends without waiting: `:busy` if the program does not read fast enough, `:down` if it has ended."
  @spec command(port(), iodata()) :: :ok | :busy | :down
  def command(port, packet) do
    if Port.command(port, packet, [:nosuspend]), do: :ok, else: :busy
  rescue
    ArgumentError -> :down
  end

  @doc "Gives it up: closes its stdin, so that it ends as soon as it can. No more of its packets are delivered."
  @spec stop(port()) :: :ok
  def stop(port) do
    Process.unlink(port)

    try do
      Port.close(port)
    rescue
      ArgumentError -> :ok
    end

    drop_packets(port)
  end

  defp drop_packets(port) do
    receive do
      {^port, _packet} -> drop_packets(port)
      {:EXIT, ^port, _reason} -> drop_packets(port)
    after
      0 -> :ok
    end
  end

  @doc "The message for the user if the program is missing."
  @spec missing_message(Path.t()) :: String.t()
  def missing_message(path) do
    "serial ports cannot be opened: there is no port program at #{path} (circuits_uart was compiled without a C " <>
      "compiler). Fix: apt-get install gcc libc6-dev, then mix deps.compile circuits_uart --force"
  end
end

defmodule Aerie.CLI.NatsSetup do
  @moduledoc "The command `bin/nats-setup`: keys, certificates and accounts of a fleet (`Aerie.Fleet.Bridge.Hub.Setup`)."

  alias Aerie.Fleet.Bridge.Hub.Setup

  @switches [
    host: :keep,
    vehicle: :keep,
    revoke: :keep,
    new_gateway_key: :boolean,
    environment: :string,
    help: :boolean
  ]

  @help """
  usage: bin/nats-setup FOLDER [OPTION ...]

    Writes what a hub's nats-server and the leaf nodes of its vehicles need: accounts, keys, certificates, configuration. --host is
    required the first time. Run it again to add or remove vehicles; docs/fleet.md explains the files.

    --host NAME          a server of the hub, by the name or address at which vehicles reach it; three make a cluster (may be repeated)
    --vehicle ID         a vehicle to add (may be repeated)
    --revoke ID          a vehicle to remove: its key stops working (may be repeated)
    --new-gateway-key    another key for the hub's gateways and operators: the one that they have stops working
    --environment NAME   second word of every subject (prod)
    --help               print this text
  """

  @doc "Entry point of `bin/nats-setup`: prints, and ends the program with status 0 or 2."
  @spec main([String.t()]) :: no_return()
  def main(words) do
    case call(words, System.get_env("AERIE_CWD") || File.cwd!()) do
      {:ok, text} -> finish(:stdio, text, 0)
      {:error, text} -> finish(:stderr, text, 2)
    end
  end

  @spec finish(:stdio | :stderr, String.t(), 0 | 2) :: no_return()
  defp finish(device, text, status) do
    IO.write(device, text)
    System.halt(status)
  end

  @doc "Does what `main/1` does; file names are relative to `folder`."
  @spec call([String.t()], Path.t()) :: {:ok | :error, String.t()}
  def call(words, folder) do
    case OptionParser.parse(words, strict: @switches) do
      {options, words, []} -> run(options, words, folder)
      {_options, _words, [{name, _value} | _]} -> wrong("#{name} is not an option, or has no value")
    end
  end

  defp run(options, words, folder) do
    case {options[:help], words} do
      {true, _words} -> {:ok, @help}
      {nil, [dir]} -> write(Path.expand(dir, folder), options)
      {nil, _none_or_many} -> wrong("expected one FOLDER")
    end
  end

  defp write(dir, options) do
    wish = %{
      environment: options[:environment],
      hosts: Keyword.get_values(options, :host),
      vehicles: Keyword.get_values(options, :vehicle),
      revoked: Keyword.get_values(options, :revoke),
      new_gateway_key: options[:new_gateway_key] == true
    }

    case Setup.write(dir, wish) do
      {:ok, lines} -> {:ok, Enum.map_join(lines, &(&1 <> "\n"))}
      {:error, text} -> {:error, "error: #{text}\n"}
    end
  end

  defp wrong(text), do: {:error, "error: #{text}\nbin/nats-setup --help lists the options\n"}
end

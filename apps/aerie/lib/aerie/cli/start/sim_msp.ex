defmodule Aerie.CLI.Start.SimMsp do
  @moduledoc "The simulated Betaflight and iNav vehicles of `--sim-msp`: a link for each, and the process that simulates it. They alternate."

  alias Aerie.CLI.Start.Ports
  alias MavRouter.Link.Spec

  @loopback {127, 0, 0, 1}
  # Where Betaflight's and iNav's own simulators have MSP.
  @first_port 5761
  # Behind those of --sim.
  @first_system 201
  # Degrees of latitude between two of them.
  @apart 0.0004

  @doc "How many there may be."
  @spec most() :: pos_integer
  def most, do: 20

  @doc "A configuration with their links, and their ports."
  @spec links(map, non_neg_integer) :: {:ok, map, [:inet.port_number()]} | {:error, [String.t()]}
  def links(config, 0), do: {:ok, config, []}

  def links(config, count) do
    if Code.ensure_loaded?(SimVehicle.Msp),
      do: Enum.reduce_while(1..count, {:ok, config, []}, &link/2),
      else: {:error, ["a release has no simulated vehicles: give --link or --config"]}
  end

  defp link(number, {:ok, config, ports}) do
    case Ports.free_tcp(@loopback, List.last(ports, @first_port - 1) + 1) do
      {:ok, port} ->
        id = "sim-msp-#{number}"
        url = "msp:tcp:127.0.0.1:#{port}?sysid=#{@first_system + number - 1}"
        {:ok, spec} = Spec.parse(url, id: id, network: "sim")

        link = %{
          id: id,
          network: "sim",
          label: "simulated #{firmware(number)}",
          enabled: true,
          given: false,
          url: url,
          spec: spec
        }

        {:cont, {:ok, %{config | links: config.links ++ [link]}, ports ++ [port]}}

      {:error, :none_free} ->
        {:halt,
         {:error,
          [
            "no free TCP port for the simulated vehicles: end the programs that use port #{@first_port} and the ones after it"
          ]}}
    end
  end

  @doc "The part of the program that simulates them."
  @spec part([:inet.port_number()]) :: [{:sim_msp, Supervisor.child_spec()}]
  def part([]), do: []

  def part(ports) do
    children =
      for {port, number} <- Enum.with_index(ports, 1) do
        flight = %{lat: 47.397742 - @apart * number, lon: 8.5456}
        {SimVehicle.Msp, firmware: firmware(number), port: port, uid: number, pilot: true, flight: flight}
      end

    [
      {:sim_msp,
       %{
         id: :sim_msp,
         type: :supervisor,
         start: {Supervisor, :start_link, [children, [strategy: :one_for_one]]}
       }}
    ]
  end

  defp firmware(number), do: if(rem(number, 2) == 1, do: :betaflight, else: :inav)
end

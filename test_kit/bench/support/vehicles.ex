defmodule Bench.Vehicles do
  @moduledoc """
  Vehicles of `vehicle_load.c`, each on a socket of its own, spread over as many links as their system ids need.
  """

  alias Bench.OSProcess

  # Systems of one network: an id is a byte, and a few are taken.
  @of_network 240

  @enforce_keys [:load, :port, :count, :rate, :urls]
  defstruct @enforce_keys ++ [watched: 0]

  @type t :: %__MODULE__{}

  @doc """
  So many vehicles that each say `rate` frames a second. The first `watched` of each link change their mode with each
  heartbeat.
  """
  @spec new(Path.t(), pos_integer(), pos_integer(), non_neg_integer()) :: t()
  def new(load, count, rate, watched \\ 0) do
    port = OSProcess.base_port(Stream.concat(0..10, 1_000..(1_000 + count)))
    urls = for n <- 0..(ceil(count / @of_network) - 1), do: "udpin:127.0.0.1:#{port + n}"
    %__MODULE__{load: load, port: port, count: count, rate: rate, watched: watched, urls: urls}
  end

  @doc """
  Says their frames for so many seconds, beside so many made-up heartbeats a second. Gives the frames other than
  heartbeats.
  """
  @spec run(t(), pos_integer(), non_neg_integer()) :: non_neg_integer()
  def run(vehicles, seconds, fakes \\ 0) do
    OSProcess.load(vehicles.load, args(vehicles, seconds, fakes))["sent"]
  end

  @doc """
  The same at a higher priority, where that is allowed: the frames other than heartbeats (`sent`), and how long they
  took (`seconds`).
  """
  @spec offer(t(), pos_integer()) :: map()
  def offer(vehicles, seconds) do
    {text, 0} =
      System.cmd("nice", ["-n", "-15", vehicles.load | Enum.map(args(vehicles, seconds, 0), &to_string/1)])

    JSON.decode!(text)
  end

  defp args(%{port: port, count: count, urls: urls, rate: rate, watched: watched}, seconds, fakes),
    do: [port, count, length(urls), rate, seconds, fakes, watched]
end

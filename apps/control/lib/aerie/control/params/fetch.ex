defmodule Aerie.Control.Params.Fetch do
  @moduledoc """
  Reads the whole list in the best way that the vehicle offers: ArduPilot's parameter file by MAVLink FTP; otherwise, or if that fails,
  `Aerie.Control.Params.Fetch.Download`. A vehicle that announces FTP and does not answer is asked for eight seconds; `heard?/1` lets the
  caller remember that.

  A stored list (`:stored`) is returned, and nothing else is read, if the vehicle's checksum or `_HASH_CHECK` is still the
  list's.

  The checksum of the file is read before and after the file. Only if both are equal does it belong to the list and can later show that
  the list is still right. It is never computed from the bytes, because padding depends on how the file is read.

  Events and actions are those of `Aerie.Control.Params.Fetch.Download`; `{:progress, _, _}` counts bytes while the file is read, and parameters
  of a list.
  """

  alias Aerie.Control.Ftp.{Client, RoundTrip}
  alias Aerie.Control.Params.{Cache, Param, Set, Table}
  alias Aerie.Control.Params.Fetch.Download
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Enums.MavProtocolCapability
  alias MavCodec.Ftp.PackedParams

  @ftp MavProtocolCapability.value(:MAV_PROTOCOL_CAPABILITY_FTP)
  @silent_us RoundTrip.silence()
  @max_file_bytes 262_144

  @enforce_keys [:target, :deadline, :options]
  defstruct [
    :target,
    :deadline,
    :options,
    :machine,
    :crc,
    :crc_after,
    :table,
    :heard?,
    phase: :idle,
    seq: 0,
    data: []
  ]

  @type t :: %__MODULE__{}

  @doc "Whether the vehicle of a snapshot offers its parameters as a file."
  @spec file?(map()) :: boolean()
  def file?(snapshot) do
    Firmware.traits(snapshot.autopilot).param_file? and
      Bitwise.band(snapshot.capabilities || 0, @ftp) != 0
  end

  @doc """
  A fetch that has not begun. Options are those of `Aerie.Control.Params.Fetch.Download.new/3`, and `:file` (whether to try the file: ArduPilot
  with the capability FTP), `:stored`, `:defaults` (true: the firmware's defaults with it), `:us` and `:seq` of `Aerie.Control.Ftp.Client.new/4`.
  """
  @spec new({non_neg_integer(), 0..255}, deadline :: integer(), keyword()) :: t()
  def new(target, deadline, options \\ []),
    do: %__MODULE__{target: target, deadline: deadline, options: options, seq: Keyword.get(options, :seq, 0)}

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{machine: nil}), do: nil
  def wake_at(%{machine: %module{} = machine}), do: module.wake_at(machine)

  @doc "The number that the next FTP transfer with this vehicle has to begin with."
  @spec seq(t()) :: 0..65_535
  def seq(fetch), do: fetch.seq

  @doc "Whether FTP was answered; nil if it was not asked for."
  @spec heard?(t()) :: boolean() | nil
  def heard?(fetch), do: fetch.heard?

  @spec handle(t(), Download.event()) :: {t(), [Download.action()]}
  def handle(%{phase: :done} = fetch, _event), do: {fetch, []}

  def handle(%{phase: :idle} = fetch, {:start, now}) do
    cond do
      fetch.options[:file] -> transfer(fetch, :crc, now)
      match?(%Table{hash: hash} when hash != nil, fetch.options[:stored]) -> hash(fetch, now)
      true -> list(fetch, now)
    end
  end

  def handle(%{phase: :idle} = fetch, {:cancel, _now}), do: finish(fetch, {:error, :cancelled})
  def handle(%{phase: :idle} = fetch, _early), do: {fetch, []}

  def handle(%{machine: %module{} = machine} = fetch, event) do
    {machine, actions} = module.handle(machine, event)
    Enum.reduce(actions, {%{fetch | machine: machine}, []}, &act(&1, &2, time(event)))
  end

  defp time(event), do: elem(event, tuple_size(event) - 1)

  defp act({:data, offset, bytes}, {fetch, actions}, _now),
    do: {%{fetch | data: [{offset, bytes} | fetch.data]}, actions}

  defp act({:done, result}, {fetch, actions}, now) do
    {fetch, more} = ended(seq_of(fetch), result, now)
    {fetch, actions ++ more}
  end

  defp act(action, {fetch, actions}, _now), do: {fetch, actions ++ [action]}

  defp seq_of(%{machine: %Client{} = client} = fetch),
    do: %{fetch | seq: Client.seq(client), heard?: Client.heard?(client)}

  defp seq_of(fetch), do: fetch

  defp ended(%{phase: :list} = fetch, result, _now), do: finish(fetch, result)

  defp ended(fetch, {:error, reason}, _now) when reason in [:cancelled, :deadline],
    do: finish(fetch, {:error, reason})

  defp ended(%{phase: :crc} = fetch, {:ok, crc}, now) do
    if fresh?(fetch, %{file_crc: crc}),
      do: finish(fetch, {:ok, fetch.options[:stored]}),
      else: transfer(%{fetch | crc: crc}, :read, now)
  end

  defp ended(%{phase: :hash} = fetch, {:ok, param}, now) do
    if fresh?(fetch, %{hash: param.value}),
      do: finish(fetch, {:ok, fetch.options[:stored]}),
      else: list(fetch, now)
  end

  # A vehicle without checksums may have the file all the same; one that does not answer has neither.
  defp ended(%{phase: :crc} = fetch, {:error, reason}, now) when reason != :no_answer,
    do: transfer(fetch, :read, now)

  defp ended(%{phase: :read} = fetch, {:ok, _size}, now) do
    bytes = fetch.data |> Enum.sort() |> Enum.map(&elem(&1, 1)) |> IO.iodata_to_binary()

    case PackedParams.decode(bytes, Table.max()) do
      {:ok, params} ->
        fetch = %{fetch | table: Table.new(Enum.map(params, &Param.unpack/1)), data: []}
        if fetch.crc, do: transfer(fetch, :crc_after, now), else: finish(fetch, {:ok, fetch.table})

      {:error, _damaged} ->
        list(fetch, now)
    end
  end

  defp ended(%{phase: :crc_after} = fetch, result, _now) do
    crc = if result == {:ok, fetch.crc}, do: fetch.crc
    finish(fetch, {:ok, %{fetch.table | file_crc: crc}})
  end

  defp ended(fetch, {:error, _reason}, now), do: list(fetch, now)

  defp transfer(fetch, phase, now) do
    path = PackedParams.path(Keyword.get(fetch.options, :defaults, true))
    operation = if phase == :read, do: {:read, path}, else: {:crc, path}

    options =
      [former: fetch.machine, seq: fetch.seq, max_bytes: @max_file_bytes, silent_us: @silent_us] ++
        Keyword.take(fetch.options, [:us, :rtt_us])

    start(%{fetch | phase: phase}, Client.new(operation, fetch.target, fetch.deadline, options), now)
  end

  defp fresh?(fetch, evidence) do
    stored = fetch.options[:stored]
    stored != nil and Cache.freshness(stored, evidence) == :fresh
  end

  defp hash(fetch, now) do
    read = Set.read("_HASH_CHECK", fetch.target, fetch.deadline, fetch.options)
    start(%{fetch | phase: :hash}, read, now)
  end

  defp list(fetch, now),
    do:
      start(%{fetch | phase: :list, data: []}, Download.new(fetch.target, fetch.deadline, fetch.options), now)

  defp start(fetch, %module{} = machine, now) do
    {machine, actions} = module.handle(machine, {:start, now})
    {%{fetch | machine: machine}, actions}
  end

  defp finish(fetch, result), do: {%{fetch | phase: :done, machine: nil}, [{:done, result}]}
end

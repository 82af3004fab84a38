defmodule Aerie.Control.Operations.Logs.Read do
  @moduledoc """
  A log over NATS comes in pieces, each with a request of its own: nobody gets more at once than asked for, and what
  was interrupted goes on with the next request. Over REST it is streamed.
  """
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Logs

  @piece 262_144
  # With base64 and its frame it is below the megabyte of a message of NATS.
  @max_piece 700_000

  @impl true
  def operation do
    next = described(nullable(count()), "where the next piece begins; null: this is the last one")

    %Operation{
      name: "logs.read",
      meaning: "Reads a piece of a log on board.",
      fields: [
        log(),
        field(:offset, {:integer, 0, 0xFFFF_FFFF}, "where the piece begins", default: 0),
        field(:bytes, {:integer, 1, @max_piece}, "the most bytes of this piece", default: @piece)
      ],
      answer: %{size: count(), offset: count(), next: next, data: data()},
      routes: [
        get("/api/vehicles/:id/logs/:log", "A log on board.",
          media: ["application/octet-stream"],
          stream?: true
        )
      ]
    }
  end

  @impl true
  def run(%{log: log, offset: offset, bytes: bytes}, %{gateway: gateway, vehicle: vehicle, options: options}) do
    with {:ok, %{size: size}} <- Logs.same(gateway, vehicle, log, options),
         from = min(offset, size),
         piece = %{log | size: min(from + bytes, size)},
         {{:ok, _to}, data} <- Logs.fold(gateway, vehicle, piece, from, [], &[&2 | &1], options) do
      data = IO.iodata_to_binary(data)
      next = from + byte_size(data)
      # Nothing more is there, or the log is smaller than the list says.
      ends? = next >= size or next < piece.size

      {:ok, %{size: size, offset: from, next: if(not ends?, do: next), data: Base.encode64(data)}}
    else
      {{:error, result}, _data} -> {:error, result}
      error -> error
    end
  end
end

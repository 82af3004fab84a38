defmodule Aerie.Console.Pages.Vehicle.LinkTable.Links do
  @moduledoc "The links that hear one vehicle, with the quality of each. Pure."

  @typedoc """
    * `:loss` - share of the vehicle's frames that were lost on this link, 0..1; `:round_trip_ms` of the link
    * `:carries` - whether the gateway's frames go out on this link; nil if it is the only one
    * nil means "not known"
  """
  @type row :: %{
          id: String.t(),
          url: String.t(),
          status: atom(),
          text: String.t(),
          loss: float() | nil,
          received: non_neg_integer() | nil,
          lost: non_neg_integer() | nil,
          round_trip_ms: number() | nil,
          score: number() | nil,
          carries: boolean() | nil,
          latest: boolean()
        }

  @doc "The rows for a vehicle's snapshot and all links with their sources (`MavRouter.Link.list/1`); the link that heard it last comes first."
  @spec of(map(), [map()]) :: [row()]
  def of(vehicle, links) do
    by_id = Map.new(links, &{&1.id, &1})

    for {id, i} <- Enum.with_index(vehicle.links), %{} = link <- [by_id[id]] do
      sources =
        for {{system, _component}, source} <- link[:sources] || %{}, system == vehicle.system_id, do: source

      quality = link[:quality] || %{}

      Map.merge(counted(sources), %{
        id: id,
        url: link[:label] || link[:url],
        status: link.status,
        text: link[:text] || "",
        round_trip_ms: quality[:rtt_ms],
        score: quality[:score],
        carries: quality[:carries],
        latest: i == 0
      })
    end
  end

  # All components of the vehicle together.
  defp counted([]), do: %{received: nil, lost: nil, loss: nil}

  defp counted(sources) do
    received = sources |> Enum.map(&(&1[:received] || 0)) |> Enum.sum()
    lost = sources |> Enum.map(&(&1[:lost] || 0)) |> Enum.sum()
    %{received: received, lost: lost, loss: if(received + lost > 0, do: lost / (received + lost))}
  end
end

defmodule Aerie.Incident.Track do
  @moduledoc "The ground track as SVG, north up, with a scale in metres and no map. Pure."

  import Aerie.Incident.Html

  @size 420
  @margin 24
  @metres 111_320.0

  @doc "The drawing of places `{latitude, longitude}` in degrees, in order; at least one."
  @spec svg([{number(), number()}, ...]) :: iodata()
  def svg([{latitude, longitude} | _more] = places) do
    # Metres around the first place. A track across the date line stays whole.
    east = @metres * :math.cos(latitude * :math.pi() / 180)
    points = for {lat, lon} <- places, do: {around(lon - longitude) * east, (lat - latitude) * @metres}
    {{left, right}, {bottom, top}} = {ends(points, 0), ends(points, 1)}
    extent = Enum.max([right - left, top - bottom, 10.0])
    factor = (@size - 2 * @margin) / extent
    {middle_x, middle_y} = {(left + right) / 2, (bottom + top) / 2}

    place = fn {x, y} -> {@size / 2 + (x - middle_x) * factor, @size / 2 - (y - middle_y) * factor} end
    drawn = Enum.map(points, place)
    scale = scale(extent)

    [
      ~s(<svg class="track" viewBox="0 0 #{@size} #{@size}" role="img" aria-label="Ground track">),
      ~s(<polyline points="#{Enum.map_join(drawn, " ", fn {x, y} -> "#{coordinate(x)},#{coordinate(y)}" end)}"/>),
      circle(hd(drawn), "begin", "begin"),
      circle(List.last(drawn), "end", "end"),
      ~s(<path class="scale" d="M12 #{@size - 12}h#{coordinate(scale * factor)}"/>),
      ~s(<text x="12" y="#{@size - 18}">#{round(scale)} m</text>),
      ~s(<text class="north" x="#{@size - 20}" y="18">N ↑</text></svg>)
    ]
  end

  defp around(degrees) when degrees > 180, do: degrees - 360
  defp around(degrees) when degrees < -180, do: degrees + 360
  defp around(degrees), do: degrees

  defp ends(points, axis), do: points |> Enum.map(&elem(&1, axis)) |> Enum.min_max()

  defp circle({x, y}, class, title),
    do:
      ~s(<circle class="#{class}" cx="#{coordinate(x)}" cy="#{coordinate(y)}" r="4"><title>#{title}</title></circle>)

  # The longest round length that fits a third of the drawing.
  defp scale(extent) do
    power = :math.pow(10, Float.floor(:math.log10(extent / 3)))
    Enum.find([5, 2, 1], 1, &(&1 * power <= extent / 3)) * power
  end
end

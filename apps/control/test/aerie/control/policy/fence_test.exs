defmodule Aerie.Control.Policy.FenceTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Fence

  # A field of about 1.1 km by 0.76 km, a second one east of it that overlaps, a tower in the first, heights.
  @fence """
  {"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "west"},
     "geometry": {"type": "Polygon", "coordinates": [[[8.00, 47.00], [8.01, 47.00], [8.01, 47.01], [8.00, 47.01]]]}},
    {"type": "Feature", "properties": {"name": "east", "max_altitude": 50},
     "geometry": {"type": "Polygon", "coordinates": [[[8.009, 47.00], [8.02, 47.00], [8.02, 47.01], [8.009, 47.01]]]}},
    {"type": "Feature", "properties": {"name": "tower", "fence": "exclusion", "radius": 100, "max_altitude": 600,
                                       "altitude_reference": "msl"},
     "geometry": {"type": "Point", "coordinates": [8.005, 47.005]}}]}
  """

  setup_all do
    {:ok, fence} = Fence.parse(@fence)
    {:ok, fence: fence}
  end

  defp at(lat, lon, home \\ 20, msl \\ 500), do: %{lat: lat, lon: lon, home: home, msl: msl}

  test "positions", %{fence: fence} do
    for {position, expected} <- [
          {at(47.005, 8.001), :ok},
          {at(47.005, 8.001, nil, nil), :ok},
          {at(47.005, 8.015), :ok},
          {at(47.005, 8.015, 60),
           ~s|the target 47.005000, 8.015000 is outside the heights of the zone "east" (up to 50 m above home; it is at 60 m)|},
          {at(47.005, 8.015, nil),
           ~s|the target 47.005000, 8.015000 is outside the heights of the zone "east" (up to 50 m above home; its height above home is not known)|},
          {at(47.005, 7.999), ~s|the target 47.005000, 7.999000 is 76 m outside the zone "west"|},
          {at(47.005, 7.2), ~s|the target 47.005000, 7.200000 is 60.8 km outside the zone "west"|},
          {at(-47, -172),
           ~s|the target -47.000000, -172.000000 is thousands of kilometres outside the zone "west"|},
          {at(47.005, 8.005),
           ~s|the target 47.005000, 8.005000 is in the exclusion zone "tower", 100 m inside its border (up to 600 m above mean sea level; it is at 500 m)|},
          {at(47.005, 8.005, 20, nil),
           ~s|the target 47.005000, 8.005000 is in the exclusion zone "tower", 100 m inside its border (up to 600 m above mean sea level; its height above mean sea level is not known)|},
          {at(47.005, 8.005, 20, 601), :ok}
        ] do
      expected = if expected == :ok, do: :ok, else: {:deny, :geofence, expected}
      assert Fence.check_position(fence, position, "the target") == expected
    end
  end

  test "ways", %{fence: fence} do
    for {from, to, expected} <- [
          {at(47.001, 8.001), at(47.009, 8.001), :ok},
          # Across the overlap of both fields, low enough for the second one.
          {at(47.001, 8.001), at(47.001, 8.019), :ok},
          {at(47.001, 8.001, 60), at(47.001, 8.019, 10), :ok},
          {at(47.001, 8.001, 200), at(47.001, 8.019, 10),
           ~s|the way (1382 m) leaves all 2 inclusion zones after 691 m|},
          # Through the tower, and over it.
          {at(47.005, 8.001), at(47.005, 8.009),
           ~s|the way (608 m) enters the exclusion zone "tower" after 204 m|},
          {at(47.005, 8.001, 20, 650), at(47.005, 8.009, 20, 650), :ok},
          {at(47.005, 8.001, 20, 650), at(47.005, 8.009, 20, 600.1), :ok},
          {at(47.005, 8.001, 20, 610), at(47.005, 8.009, 20, 590),
           ~s|the way (608 m) enters the exclusion zone "tower" after 304 m|},
          # Straight up.
          {at(47.001, 8.019, 0), at(47.001, 8.019, 45), :ok},
          {at(47.001, 8.019, 0), at(47.001, 8.019, 100),
           ~s|the way (100 m) leaves all 2 inclusion zones after 50 m|},
          # Whoever is outside already may come back, but not leave again.
          {at(47.005, 7.99), at(47.001, 8.001), :ok},
          {at(47.005, 7.99), at(47.005, 8.03), ~s|enters the exclusion zone "tower"|},
          {at(47.001, 7.99), at(47.001, 8.03), ~s|leaves all 2 inclusion zones|},
          {at(47.005, 8.005), at(47.001, 8.001), :ok},
          {at(47.005, 8.005), at(47.005, 8.0051, 20, 700), :ok},
          {at(47.005, 8.001), at(20, 8.001), "ways of more than 1000.0 km are not judged"}
        ] do
      case expected do
        :ok ->
          assert Fence.check_way(fence, from, to, "the way") == :ok

        text ->
          assert {:deny, :geofence, got} = Fence.check_way(fence, from, to, "the way")
          assert got =~ text
      end
    end
  end

  test "a file that is missing, empty or wrong says so with its name" do
    dir = Path.join(System.tmp_dir!(), "fence-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dir)
    on_exit(fn -> File.rm_rf!(dir) end)
    path = Path.join(dir, "fence.geojson")
    assert Fence.read(path) == {:error, ["#{path}: no such file or directory"]}
    File.write!(path, "")
    assert {:error, [text]} = Fence.read(path)
    assert text =~ "#{path}: line 1: expected JSON, got the end of the file"
    assert {:error, [_]} = Fence.read(dir)
    File.write!(path, @fence)
    assert {:ok, %Fence{zones: [_, _, _]}} = Fence.read(path)
  end
end

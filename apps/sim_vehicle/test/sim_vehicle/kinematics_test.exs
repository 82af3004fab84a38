defmodule SimVehicle.KinematicsTest do
  use ExUnit.Case, async: true

  alias SimVehicle.Physics.{Geo, Kinematics, Wind}

  @limits %{yaw: :keep, speed: 10.0, accel: 2.0, up: 2.5, down: 1.5}

  test "reaches a point without overshooting, within its limits" do
    setpoint = Map.merge(@limits, %{xy: {:pos, 100.0, -50.0}, z: {:pos, -30.0}})

    path = Enum.scan(1..1000, %Kinematics{}, fn _step, kin -> Kinematics.step(kin, setpoint, 0.05) end)
    last = List.last(path)
    assert_in_delta last.n, 100.0, 0.1
    assert_in_delta last.e, -50.0, 0.1
    assert_in_delta last.d, -30.0, 0.1
    assert Enum.all?(path, &(Kinematics.groundspeed(&1) <= 10.001 and &1.vd >= -2.501))
    assert Enum.all?(path, &(:math.sqrt(&1.an ** 2 + &1.ae ** 2) <= 2.001))
    assert path |> Enum.map(& &1.n) |> Enum.max() < 100.5
  end

  test "turns the short way" do
    setpoint = Map.merge(@limits, %{xy: {:vel, 0.0, 0.0}, z: {:vel, 0.0}, yaw: {:to, -3.0}})

    path =
      Enum.scan(1..200, %Kinematics{d: -10.0, yaw: 3.0}, fn _step, kin ->
        Kinematics.step(kin, setpoint, 0.05)
      end)

    assert_in_delta List.last(path).yaw, -3.0, 0.01
    assert Enum.all?(path, &(abs(&1.yaw) > 2.9))
  end

  test "meets the ground once, with the speed it had" do
    setpoint = Map.merge(@limits, %{xy: {:vel, 0.0, 0.0}, z: {:vel, 0.5}})
    path = Enum.scan(1..200, %Kinematics{d: -2.0}, fn _step, kin -> Kinematics.step(kin, setpoint, 0.05) end)
    assert_in_delta hd(for %{impact: speed} when speed != nil <- path, do: speed), 0.5, 0.01
    assert Enum.all?(path, &(&1.d <= 0.0))
  end

  test "falls when the motors stop in the air, stands still on the ground" do
    path = Enum.scan(1..100, %Kinematics{d: -20.0}, fn _step, kin -> Kinematics.step(kin, :off, 0.05) end)
    [impact | _later] = for %{impact: speed} when speed != nil <- path, do: speed
    assert_in_delta impact, :math.sqrt(2 * 9.80665 * 20), 0.5
    assert %{d: +0.0, vd: +0.0} = Kinematics.step(%Kinematics{}, :off, 0.05)
  end

  test "gusts are the same for the same seed, calm is calm" do
    gusts = fn seed ->
      Enum.scan(1..100, Wind.new(1.0, seed), fn _step, wind -> Wind.step(wind, 0.1) end)
      |> Enum.map(&Wind.velocity/1)
    end

    assert gusts.(7) == gusts.(7)
    assert gusts.(7) != gusts.(8)
    assert Wind.velocity(Wind.step(Wind.new(0.0, 1), 1.0)) == {0.0, 0.0}
  end

  test "local and global positions convert there and back, across the date line too" do
    for origin <- [
          %{lat: -353_632_610, lon: 1_491_652_300, alt: 0.0},
          %{lat: 0, lon: 1_799_999_900, alt: 0.0}
        ],
        {n, e} <- [{500.0, -300.0}, {-20.0, 40.0}] do
      {lat, lon} = Geo.to_global(origin, n, e)
      assert lon in -1_800_000_000..1_800_000_000
      {n2, e2} = Geo.to_local(origin, lat, lon)
      assert_in_delta n, n2, 0.02
      assert_in_delta e, e2, 0.02
    end
  end

  test "inside a polygon" do
    square = [{0.0, 0.0}, {0.0, 10.0}, {10.0, 10.0}, {10.0, 0.0}]
    assert Geo.inside?(square, {5.0, 5.0})
    refute Geo.inside?(square, {5.0, 15.0})
    refute Geo.inside?(square, {-1.0, 5.0})
  end
end

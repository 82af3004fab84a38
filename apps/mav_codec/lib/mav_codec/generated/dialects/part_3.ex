defmodule MavCodec.Generated.Dialects.Part3 do
  use MavCodec.Definition.Shard, dialects: {3, 4}
end

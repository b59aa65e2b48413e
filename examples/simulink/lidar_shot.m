function [shot, range_m, closing_speed_mps] = lidar_shot(datagram)
% Shot number, ranges and closing speeds of four beams (NaN: not valid) from the 161 bytes of UDP Receive.
% Little-endian, as simulink.toml defines it; docs/simulators.md has the other fields.
bytes = reshape(datagram(1:161), 1, 161);
shot = typecast(bytes(31:34), 'uint32');
range_m = nan(4, 1);
closing_speed_mps = nan(4, 1);
for beam = 1:4
    at = 35 + 31 * (beam - 1);
    if bitget(bytes(at + 1), 2)
        range_m(beam) = 0.001 * double(typecast(bytes(at + (5:8)), 'uint32'));
    end
    if bitget(bytes(at + 1), 3)
        closing_speed_mps(beam) = 0.0001 * double(typecast(bytes(at + (9:12)), 'int32'));
    end
end
end
